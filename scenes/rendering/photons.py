"""The glue lens as real glass: where Mitsuba's photons leave its cap, and in which direction.

The referee of the vector-irradiance table: it shares nothing with `optics` but the lens's numbers.
Import after `load_mitsuba`.
"""

from __future__ import annotations

import math

import drjit as dr
import mitsuba as mi
import numpy as np

import optics

# Rays start this far behind the rim's plane, so that a flat end is ahead of them.
_RUN_UP_MM = 1e-3
# What is still in the glass after so many reflections goes round by total reflection.
_MAX_REFLECTIONS = 16
# Photons of a pass. The film adds equal light in float32, whose rounding is then the same at every
# photon: 10,000 in one pixel would be off by up to 0.06 %. Passes are added in float64.
_PASS = 1 << 19


class Glass:
    """A drop of glue with a cap of smooth glass, an absorbing side and an absorbing core face.

    In the lens's frame: the vertex is the origin, +z runs away from the fibre.

    Args:
        lens: the lens.
        medium_index: refractive index of the medium in front of it.
    """

    def __init__(self, lens: optics.GlueLens, *, medium_index: float) -> None:
        self.aperture, self.sag = float(lens.aperture_radius), float(lens.sag)
        self.length = float(lens.glue_length)
        index = float(lens.glue_index)
        self.face_radius, self.sine_limit = float(lens.face_radius), float(lens.sine_limit)
        self.launch_radius = _optional(lens.launch_radius)
        launch_aperture = _optional(lens.launch_aperture)
        self.launch_sine = None if launch_aperture is None else launch_aperture / index
        cap = {"type": "disk", "to_world": mi.ScalarTransform4f().scale(self.aperture)}
        if self.sag > 0:
            radius = 1 / float(lens.curvature)
            cap = {"type": "sphere", "radius": radius, "center": [0.0, 0.0, -radius]}
        glass = {"type": "dielectric", "int_ior": index, "ext_ior": medium_index}
        self.cap = mi.load_dict({"type": "scene", "cap": {**cap, "bsdf": glass}})
        self.surface = self.cap.shapes()[0].bsdf()

    def sample_ray(self, choice, place, direction):
        """A ray of the core's light as it leaves the cap; all carry the same power.

        Args:
            choice: uniform number that decides between reflection and refraction.
            place: two uniform numbers, on the core's face.
            direction: two uniform numbers, for the direction across the axis.

        Returns:
            The ray in the lens's frame, and whether it came out; the side and the core's face
            swallow the others.
        """
        lateral = _disc(direction, extent=self.sine_limit, waist=self.launch_sine)
        forward = dr.safe_sqrt(1 - dr.squared_norm(lateral))
        heading = mi.Vector3f(lateral.x, lateral.y, forward)
        start = _disc(place, extent=self.face_radius, waist=self.launch_radius)
        slope = lateral / forward
        rim = start + (self.length - self.sag) * slope
        behind = rim - _RUN_UP_MM * slope
        ray = mi.Ray3f(mi.Point3f(behind.x, behind.y, -self.sag - _RUN_UP_MM), heading)
        inside = dr.squared_norm(rim) <= self.aperture**2
        ray, out = self._leave(ray, mi.Float(choice), inside)
        # The instrument is drawn as far as the tip, so light that heads there starts there.
        ray.o = ray(dr.select(ray.d.z > 0, -ray.o.z / ray.d.z, 0))
        return ray, out

    @dr.syntax
    def _leave(self, ray, choice, inside):
        """Follow rays through the glass until they are out, swallowed, or given up."""
        context = mi.BSDFContext(mi.TransportMode.Importance)
        out = mi.Bool(False)
        reflections = mi.UInt32(0)
        while inside:
            si = self.cap.ray_intersect(ray, inside)
            # The sphere goes on below the rim; there the side and the core's face swallow it all.
            inside &= si.is_valid() & (si.p.z >= -self.sag - _RUN_UP_MM / 2)
            scattered, _ = self.surface.sample(context, si, choice, mi.Point2f(0), inside)
            heading = si.to_world(scattered.wo)
            reflected = dr.dot(heading, si.n) < 0
            # What the choice leaves of the number is uniform again.
            choice = dr.select(reflected, choice, choice - (1 - scattered.pdf)) / scattered.pdf
            # Mitsuba lifts rays off the surface by 1e-4 mm, which a focus shows: only those that
            # must not meet their own origin are lifted.
            ray = si.spawn_ray(heading)
            ray.o = dr.select(reflected, ray.o, si.p)
            out |= inside & ~reflected
            inside &= reflected & (reflections < _MAX_REFLECTIONS)
            reflections += 1
        return ray, out


def _disc(sample, *, extent: float, waist: float | None):
    """Points on a disc, uniform, or after a Gaussian launch that ends at the disc's edge."""
    point = extent * mi.warp.square_to_uniform_disk_concentric(sample)
    if waist is None:
        return point
    share = dr.squared_norm(point) / extent**2
    within = -math.expm1(-2 * (extent / waist) ** 2)
    radius = waist * dr.sqrt(-0.5 * dr.log(1 - share * within))
    return point * radius * dr.rsqrt(dr.maximum(dr.squared_norm(point), 1e-30))


def _optional(value) -> float | None:
    return None if value is None else float(value)


def photon_image(scene, *, photons_per_pixel: int, seed: int) -> np.ndarray:
    """Radiance of directly lit surfaces by Mitsuba's particle tracer.

    Args:
        scene: a scene with a `photon_camera` for its second sensor.
        photons_per_pixel: leaving the core.
        seed: other seeds give independent images.

    Returns:
        H x W x 3, mW/(mm2 sr).
    """
    tracer = mi.load_dict({"type": "ptracer", "max_depth": 2, "hide_emitters": True})
    width, height = scene.sensors()[1].film().size()
    passes = min(math.ceil(photons_per_pixel * width * height / _PASS), photons_per_pixel)
    counts = np.diff(np.linspace(0, photons_per_pixel, passes + 1).astype(int))
    total = np.zeros((height, width, 3))
    for number, count in enumerate(counts):
        image = mi.render(
            scene, sensor=1, integrator=tracer, spp=int(count), seed=seed * passes + number
        )
        total += count / photons_per_pixel * np.asarray(image, dtype=float)
    return total
