"""Mitsuba plugins: the microscope as a pinhole, and behind a viewing path.

Import after `load_mitsuba`: the base class exists only once a variant is set.
"""

from __future__ import annotations

import json

import drjit as dr
import mitsuba as mi

# Mitsuba's stubs lack the types of the variants.
# mypy: no-check-untyped-defs


# `scenes.world.limits` refuses distortions for which these steps do not converge.
_UNDISTORT_STEPS = 12


class _WindowSensor(mi.Sensor):
    """A microscope whose lines of sight start at a height inside the eye.

    Vignetting multiplies the light by 1 - vignetting (s / s_corner)^2, where s is the distance of
    the pixel from the centre of the image.
    """

    def __init__(self, props):
        super().__init__(props)
        self.pole_height, self.entry_height = props["pole_height"], props["entry_height"]
        self.centre = mi.Vector2f(props["principal_point"])
        self.vignetting, self.aperture_slope = props["vignetting"], props["aperture_slope"]
        self.m_needs_sample_3 = self.aperture_slope > 0

    def sample_ray_differential(
        self, time, wavelength_sample, position_sample, aperture_sample, active=True
    ):
        """The same ray; the differentials stay unset, as no texture is filtered."""
        ray, part = self.sample_ray(
            time, wavelength_sample, position_sample, aperture_sample, active
        )
        return mi.RayDifferential3f(ray), part

    def _slope(self, sample):
        """Random slope of a line of sight against the central one; zero for a pinhole."""
        return self.aperture_slope * mi.warp.square_to_uniform_disk_concentric(sample)

    def _part(self, position):
        """Fraction of light that remains after vignetting."""
        size = mi.Vector2f(self.film().size())
        from_middle = (mi.Vector2f(position) - 0.5) * size
        return 1 - self.vignetting * 4 * dr.squared_norm(from_middle) / dr.squared_norm(size)

    def traverse(self, callback):
        """The principal point, which moves with the view."""
        callback.put("principal_point", self.centre, mi.ParamFlags.NonDifferentiable)


class MicroscopeSensor(_WindowSensor):
    """The pinhole of `optics.Microscope`: at any height or at infinity, with lens distortion.

    Unlike Mitsuba's `perspective`, it can look into the closed eyeball.

    With an aperture, the pinhole becomes a thin lens. All lines of sight of a pixel then cross in
    the plane in focus; their slopes against the central one are at most `aperture_slope` (tangent
    of the angle).
    """

    def __init__(self, props):
        super().__init__(props)
        self.scale, self.bend = props["scale"], props["inverse_working_distance"]
        self.distortion = tuple(props[name] for name in ("k1", "k2", "p1", "p2", "k3"))
        self.focus_height = props["focus_height"]

    def sample_ray(self, time, wavelength_sample, position_sample, aperture_sample, active=True):
        """Line of sight of a position on the film, and the fraction of light that arrives."""
        size = mi.Vector2f(self.film().size())
        ideal = self._undistorted(mi.Vector2f(position_sample) * size - self.centre)
        x, y = ideal.x * self.scale, -ideal.y * self.scale
        depth = self._depth(self.entry_height)
        aside = self._slope(aperture_sample)
        above = self.entry_height - self.focus_height
        ray = mi.Ray3f(
            mi.Point3f(x * depth - above * aside.x, y * depth - above * aside.y, self.entry_height),
            dr.normalize(mi.Vector3f(self.bend * x + aside.x, self.bend * y + aside.y, -1)),
            time,
        )
        return ray, mi.Color3f(self._part(position_sample))

    def sample_direction(self, it, sample, active=True):
        """Direction to the pinhole, and the weight of a photon's radiance on the film."""
        size = mi.Vector2f(self.film().size())
        depth = self._depth(it.p.z)
        aside = self._slope(sample)
        # Position from which the central line of sight reaches the same pixel.
        above = it.p.z - self.focus_height
        x, y = (it.p.x + above * aside.x) / depth, (it.p.y + above * aside.y) / depth
        ds = dr.zeros(mi.DirectionSample3f)
        ds.d = -dr.normalize(mi.Vector3f(self.bend * x + aside.x, self.bend * y + aside.y, -1))
        ds.dist = (self.entry_height - it.p.z) / ds.d.z
        ds.p = it.p + ds.dist * ds.d
        offset, growth = self._distorted(mi.Vector2f(x, -y) / self.scale)
        place = self.centre + offset
        seen = active & (ds.dist > 0) & dr.all((place >= 0) & (place < size))
        ds.uv = mi.Point2f(place)
        ds.pdf = dr.select(seen, mi.Float(1), 0)
        # Area of the film on the horizontal plane through the point; ds.d.z is the cosine.
        area = dr.prod(size) * dr.square(self.scale * depth) / growth
        return ds, mi.Color3f(self._part(place / size) * dr.rcp(area * ds.d.z)) & seen

    def _depth(self, height):
        return 1 - self.bend * (height - self.pole_height)

    def _distorted(self, ideal):
        """Brown's distortion of an offset from the principal point, px, and the change of area.

        Brown (1966) with the order and normalisation of OpenCV; the change of area is the
        determinant of its derivative.
        """
        k1, k2, p1, p2, k3 = self.distortion
        u, v = ideal.x, ideal.y
        x, y = u * self.bend * self.scale, v * self.bend * self.scale
        r2 = x * x + y * y
        radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
        steepness = 2 * (k1 + r2 * (2 * k2 + r2 * 3 * k3))
        offset = mi.Vector2f(
            u * radial + 2 * p1 * u * y + p2 * (3 * u * x + v * y),
            v * radial + p1 * (u * x + 3 * v * y) + 2 * p2 * u * y,
        )
        along = radial + x * x * steepness + 2 * p1 * y + 6 * p2 * x
        across = x * y * steepness + 2 * p1 * x + 2 * p2 * y
        down = radial + y * y * steepness + 6 * p1 * y + 2 * p2 * x
        return offset, along * down - across * across

    def _undistorted(self, offset):
        """Inverse of `_distorted` by fixed-point iteration, as in `optics.Microscope`."""
        ideal = offset
        if any(self.distortion):
            for _ in range(_UNDISTORT_STEPS):
                ideal = ideal + offset - self._distorted(ideal)[0]
        return ideal


mi.register_sensor("eyespot_microscope", MicroscopeSensor)


class PathSensor(_WindowSensor):
    """The camera of `optics.viewing.PathCamera`: the lines of sight inside the eye.

    The iris, or the edge of the field, hides the rest of the image.

    With an aperture, a pixel has the lines of sight of `optics.viewing.Pencils`. The iris stops all
    of them where it stops the central one.
    """

    def __init__(self, props):
        super().__init__(props)
        self.crossing, self.steepness, self.passing = json.loads(props["series"])
        self.px_per_aim, self.widest, self.pupil = (
            props[name] for name in ("px_per_aim", "widest", "pupil")
        )
        if self.aperture_slope:
            self.pencils = json.loads(props["pencils"])

    def sample_ray(self, time, wavelength_sample, position_sample, aperture_sample, active=True):
        """Line of sight of a position on the film, and the fraction of light that arrives."""
        size = mi.Vector2f(self.film().size())
        offset = (mi.Vector2f(position_sample) * size - self.centre) / self.px_per_aim
        aim = mi.Vector2f(offset.x, -offset.y)
        squared = dr.squared_norm(aim)
        place = dr.minimum(2 * squared / self.widest**2 - 1, 1)
        crossing, steepness, passing = (
            _series(terms, place) for terms in (self.crossing, self.steepness, self.passing)
        )
        at_pole, slope = crossing * aim, steepness * aim
        if self.aperture_slope:
            aside = self._slope(aperture_sample)
            across, grown_across, along, grown_along = (
                _series(terms, place) for terms in self.pencils
            )
            turned = dr.dot(aim, aside) * aim
            at_pole += across * aside + along * turned
            slope += grown_across * aside + grown_along * turned
        at_entry = at_pole - slope * (self.entry_height - self.pole_height)
        ray = mi.Ray3f(
            mi.Point3f(at_entry.x, at_entry.y, self.entry_height),
            dr.normalize(mi.Vector3f(slope.x, slope.y, -1)),
            time,
        )
        part = passing * self._part(position_sample)
        return ray, mi.Color3f(dr.select(squared <= self.pupil**2, part, 0))


def _series(terms, place):
    """A Chebyshev series by Clenshaw's recurrence."""
    after, last = mi.Float(0), mi.Float(0)
    for term in reversed(terms[1:]):
        after, last = last, term + 2 * place * last - after
    return terms[0] + place * last - after


mi.register_sensor("eyespot_path", PathSensor)
