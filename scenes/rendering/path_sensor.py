"""Mitsuba plugin: the microscope behind a viewing path.

Import after `load_mitsuba`: the base class exists only once a variant is set.
"""

# Mitsuba's stubs lack the types of the variants.
# mypy: no-check-untyped-defs

from __future__ import annotations

import json

import drjit as dr
import mitsuba as mi


class PathSensor(mi.Sensor):
    """The camera of `optics.viewing.PathCamera`: the lines of sight inside the eye.

    They start at a height inside the eye. The iris, or the edge of the field, hides the rest of the
    image. Vignetting is that of `MicroscopeSensor`.

    With an aperture, a pixel has the lines of sight of `optics.viewing.Pencils`. The iris stops all
    of them where it stops the central one.
    """

    def __init__(self, props):
        super().__init__(props)
        self.crossing, self.steepness, self.passing = json.loads(props["series"])
        self.px_per_aim, self.widest, self.pupil = (
            props[name] for name in ("px_per_aim", "widest", "pupil")
        )
        self.pole_height, self.entry_height = props["pole_height"], props["entry_height"]
        self.centre = mi.Vector2f(props["principal_point"])
        self.vignetting = props["vignetting"]
        self.aperture_slope = props["aperture_slope"]
        self.m_needs_sample_3 = self.aperture_slope > 0
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
            aside = self.aperture_slope * mi.warp.square_to_uniform_disk_concentric(aperture_sample)
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
        from_middle = (mi.Vector2f(position_sample) - 0.5) * size
        part = 1 - self.vignetting * 4 * dr.squared_norm(from_middle) / dr.squared_norm(size)
        return ray, mi.Color3f(dr.select(squared <= self.pupil**2, passing * part, 0))

    def sample_ray_differential(
        self, time, wavelength_sample, position_sample, aperture_sample, active=True
    ):
        """The same ray; the differentials stay unset, as no texture is filtered."""
        ray, part = self.sample_ray(
            time, wavelength_sample, position_sample, aperture_sample, active
        )
        return mi.RayDifferential3f(ray), part

    def traverse(self, callback):
        """The principal point, which moves with the view."""
        callback.put("principal_point", self.centre, mi.ParamFlags.NonDifferentiable)


def _series(terms, place):
    """A Chebyshev series by Clenshaw's recurrence."""
    after, last = mi.Float(0), mi.Float(0)
    for term in reversed(terms[1:]):
        after, last = last, term + 2 * place * last - after
    return terms[0] + place * last - after


mi.register_sensor("eyespot_path", PathSensor)
