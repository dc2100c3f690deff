"""The glue lens as glass, through which Mitsuba traces photons.

It checks the vector-irradiance table independently: both share only the numbers of the lens.
Import after `load_mitsuba`.
"""

import math

import drjit as dr
import mitsuba as mi
import numpy as np

from eyespot import optics

# Rays start this far behind the plane of the rim, so that they can hit a flat end.
_RUN_UP_MM = 1e-3
# A ray after so many reflections is trapped by total reflection.
_MAX_REFLECTIONS = 16
# Photons per pass. The film sums equal amounts of light in float32, and all rounding errors have
# the same sign: 10,000 photons in a pixel can be wrong by 0.06 %. Passes are summed in float64.
_PHOTONS_PER_PASS = 1 << 19


class Glass:
    """A drop of glue with a smooth cap; its side and the core's face absorb light.

    Frame of the lens: the vertex is the origin, +z points away from the fibre.

    Args:
        medium_index: refractive index of the medium in front of it.
    """

    def __init__(self, lens: optics.GlueLens, *, medium_index: float) -> None:
        self.aperture, self.sag = float(lens.aperture_radius), float(lens.sag)
        self.length = float(lens.glue_length)
        index = float(lens.glue_index)
        self.face_radius, self.sine_limit = float(lens.face_radius), float(lens.sine_limit)
        self.launch_radius, launch_aperture = (
            None if x is None else float(x) for x in (lens.launch_radius, lens.launch_aperture)
        )
        self.launch_sine = launch_aperture and launch_aperture / index
        cap = {"type": "disk", "to_world": mi.ScalarTransform4f().scale(self.aperture)}
        if self.sag > 0:
            radius = 1 / float(lens.curvature)
            cap = {"type": "sphere", "radius": radius, "center": [0.0, 0.0, -radius]}
        glass = {"type": "dielectric", "int_ior": index, "ext_ior": medium_index}
        self.cap = mi.load_dict({"type": "scene", "cap": {**cap, "bsdf": glass}})
        self.surface = self.cap.shapes()[0].bsdf()

    def sample_ray(self, choice, place, direction):
        """A ray of light from the core as it leaves the cap; all rays have the same power.

        Args:
            choice: uniform random number that selects reflection or refraction.
            place: two uniform random numbers for the position on the core's face.
            direction: two uniform random numbers for the direction across the axis.

        Returns:
            The ray in the frame of the lens, and whether it came out. The side and the core's face
            absorb the others.
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
        # The instrument ends at the plane of the tip, so light starts there.
        ray.o = ray(dr.select(ray.d.z > 0, -ray.o.z / ray.d.z, 0))
        return ray, out

    @dr.syntax
    def _leave(self, ray, choice, inside):
        """Follow rays through the glass until they leave it, are absorbed, or are trapped."""
        context = mi.BSDFContext(mi.TransportMode.Importance)
        out = mi.Bool(False)
        reflections = mi.UInt32(0)
        while inside:
            si = self.cap.ray_intersect(ray, inside)
            # Below the rim the side and the core's face absorb all light.
            inside &= si.is_valid() & (si.p.z >= -self.sag - _RUN_UP_MM / 2)
            scattered, _ = self.surface.sample(context, si, choice, mi.Point2f(0), inside)
            heading = si.to_world(scattered.wo)
            reflected = dr.dot(heading, si.n) < 0
            # Rescaled, the number is uniform again and can be reused.
            choice = dr.select(reflected, choice, choice - (1 - scattered.pdf)) / scattered.pdf
            # Mitsuba moves the origin of new rays by 1e-4 mm, which would be visible in a focus. So
            # only reflected rays, which must not hit their own origin, are moved.
            ray = si.spawn_ray(heading)
            ray.o = dr.select(reflected, ray.o, si.p)
            out |= inside & ~reflected
            inside &= reflected & (reflections < _MAX_REFLECTIONS)
            reflections += 1
        return ray, out


def _disc(sample, *, extent: float, waist: float | None):
    """Points on a disc, uniform, or from a Gaussian that is cut at the disc's edge."""
    point = extent * mi.warp.square_to_uniform_disk_concentric(sample)
    if waist is None:
        return point
    share = dr.squared_norm(point) / extent**2
    within = -math.expm1(-2 * (extent / waist) ** 2)
    radius = waist * dr.sqrt(-0.5 * dr.log(1 - share * within))
    return point * radius * dr.rsqrt(dr.maximum(dr.squared_norm(point), 1e-30))


def photon_image(scene, *, photons_per_pixel: int, seed: int) -> np.ndarray:
    """Radiance of directly lit surfaces by Mitsuba's particle tracer.

    Args:
        scene: a scene with `photon_camera` as its second sensor.
        photons_per_pixel: number of photons that leave the core, per pixel.
        seed: random seed; different seeds give independent images.

    Returns:
        H x W x 3, mW/(mm2 sr).
    """
    tracer = mi.load_dict({"type": "ptracer", "max_depth": 2, "hide_emitters": True})
    width, height = scene.sensors()[1].film().size()
    passes = min(
        math.ceil(photons_per_pixel * width * height / _PHOTONS_PER_PASS), photons_per_pixel
    )
    counts = np.diff(np.linspace(0, photons_per_pixel, passes + 1).astype(int))
    total = np.zeros((height, width, 3))
    for number, count in enumerate(counts):
        image = mi.render(
            scene, sensor=1, integrator=tracer, spp=int(count), seed=seed * passes + number
        )
        total += count / photons_per_pixel * np.asarray(image, dtype=float)
    return total
