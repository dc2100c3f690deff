"""The three sensors: which of them see their marks, and the distances that follow from marks.

All of them know the instrument's axis (from the robot), the wall's shape and their cameras, and
give the same quantity: d, the distance from the tip to the wall along the axis.
"""

from __future__ import annotations

from enum import StrEnum
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import optics
from benchmarks.studies.rivals.setup import (
    CONE,
    HEIGHT_PX,
    RADIUS_MM,
    TOOL_RADIUS_MM,
    WIDTH_PX,
    Numbers,
    Place,
    Views,
    beam_of,
)

WALL = optics.Sphere(RADIUS_MM)
"""The true wall."""
_EDGE = 32  # points of a spot's edge that must be in view
_SHAFT = 200  # points of the shaft's axis

CONTOUR_PX, MARK_PX, WALL_PX = 0.05, 1.0, 0.1
"""Stated noise: of each of 128 points of the spot's edge (as in the study of poses), of a tip or
a shadow's tip in x and y (an assumption), and of the wall's texture matched in a pair (an
assumption)."""


class Sensor(StrEnum):
    """What the distance is read from."""

    SPOT = "spot"
    SHADOW = "shadow"
    STEREO = "stereo"


class Wrong(StrEnum):
    """One thing that a sensor takes as known and that is wrong."""

    PATH = "the path is taken for a pinhole"
    LAMP = "the light guide is 1 mm elsewhere"
    AXIS = "the axis is 1° off"
    RADIUS = "the eye's radius is 0.5 mm larger"


class Outcome(StrEnum):
    """What became of a reading."""

    READ = "read"
    OUT_OF_VIEW = "out of view"
    """A mark lies outside the window, or the iris hides it."""
    HIDDEN = "hidden"
    """The instrument hides the shadow of its tip, or too much of the spot."""
    NO_SPOT = "no spot"
    """The estimator found none; spots.csv has the reason."""
    NO_TEXTURE = "no texture"
    """The two images of the wall cannot be matched."""


class Known(NamedTuple):
    """What the sensors take as known; a wrong assumption is a wrong value here.

    Attributes:
        radius: of the wall's sphere, mm; its pole is at the cameras' pole height.
        lamp: end of the light guide, mm.
        axis: unit vector of the instrument.
    """

    views: Views
    radius: Numbers
    lamp: Numbers
    axis: Numbers


class Marks(NamedTuple):
    """What is measured in the images, px.

    Attributes:
        contour: edge of the spot in the central image, n x 2.
        tip: the instrument's tip in the central image.
        shadow: the shadow of the tip there.
        tip_pair: the tip in the left and the right image, 2 x 2.
        wall_pair: a point of the wall near O in the left and the right image, 2 x 2.
    """

    contour: Numbers
    tip: Numbers
    shadow: Numbers
    tip_pair: Numbers
    wall_pair: Numbers


def marks_of(place: Place, views: Views, *, points: int) -> Marks:
    """The true marks.

    Args:
        place: of instrument and light guide.
    """
    contour = optics.cone_contour(beam_of(place), WALL, points=points).point
    shadow = shadow_of(place.tip, place.lamp)
    # Each camera projects all of its points at once: the compilation of a path takes seconds.
    central = views.centre.project(jnp.concatenate([contour, jnp.stack([place.tip, shadow])]))
    both = jnp.stack([place.tip, place.spot])
    pair = jnp.stack([camera.project(both) for camera in (views.left, views.right)])
    return Marks(
        contour=central[:-2],
        tip=central[-2],
        shadow=central[-1],
        tip_pair=pair[:, 0],
        wall_pair=pair[:, 1],
    )


def shadow_of(point: Numbers, lamp: Numbers) -> Numbers:
    """Where the shadow of points falls on the wall, from a lamp without extent, mm."""
    towards = point - lamp
    towards = towards / jnp.linalg.norm(towards, axis=-1, keepdims=True)
    return WALL.intersect(point, towards).point


def by_spot(ellipse: optics.Ellipse, known: Known) -> Numbers:
    """d by the exact spot with the ellipse's area, mm (`optics.distance_by_area`)."""
    return optics.distance_by_area(
        ellipse, optics.Sphere(known.radius), known.views.centre, axis=known.axis, **CONE
    )


def by_shadow(tip: Numbers, shadow: Numbers, known: Known) -> Numbers:
    """d by the tip and its shadow in one image, mm.

    The shadow's line of sight meets the wall at a point; the line from there to the lamp and the
    tip's line of sight meet at the tip.

    Args:
        tip: its image, px.
        shadow: image of its shadow, px.
    """
    wall = optics.Sphere(known.radius)
    points, directions = known.views.centre.ray(jnp.stack([tip, shadow]))
    foot = wall.intersect(points[1], directions[1]).point
    by_both = nearest_point((points[0], directions[0]), (foot, known.lamp - foot))
    return distance_along(wall, by_both, known)


def by_stereo(tip_pair: Numbers, wall_pair: Numbers, known: Known) -> Numbers:
    """d by the tip and a point of the wall in a stereo pair, mm.

    The wall's point says how high the wall lies; the wall's curvature is known.

    Args:
        tip_pair: the tip in the left and the right image, px.
        wall_pair: the point of the wall, px.
    """
    tip, wall = in_space(jnp.stack([tip_pair, wall_pair], axis=1), known.views)
    return distance_along(optics.Sphere(jnp.linalg.norm(wall)), tip, known)


def in_space(pairs: Numbers, views: Views) -> Numbers:
    """The points that the left and the right image show at pixels, mm."""
    return nearest_point(views.left.ray(pairs[0]), views.right.ray(pairs[1]))


def distance_along(wall: optics.Surface, tip: Numbers, known: Known) -> Numbers:
    """d from a tip to a wall along the instrument's axis, mm; negative behind the wall."""
    return wall.intersect(tip, known.axis).distance


def nearest_point(
    first: tuple[Numbers, Numbers],
    second: tuple[Numbers, Numbers],
) -> Numbers:
    """The point halfway between two lines where they are nearest, mm.

    Args:
        first: a point of a line, and its direction of any length, each ... x 3.
        second: the same of the other line.
    """
    (p, u), (q, v) = first, second
    u, v = (w / jnp.linalg.norm(w, axis=-1, keepdims=True) for w in (u, v))
    across, cosine = q - p, optics.dot(u, v)
    on_u, on_v = optics.dot(across, u), optics.dot(across, v)
    along_u = (on_u - cosine * on_v) / (1.0 - cosine**2)
    along_v = (cosine * on_u - on_v) / (1.0 - cosine**2)
    return (p + along_u[..., None] * u + q + along_v[..., None] * v) / 2.0


# Which sensors see their marks: the window, the iris, and the instrument in front.


def outcomes_at(places: Place, seen: Views) -> dict[Sensor, list[Outcome]]:
    """Whether each sensor can see its marks, for places with a leading axis."""
    inside, hidden = _visible(places, seen)
    found = {
        sensor: [Outcome.READ if one else Outcome.OUT_OF_VIEW for one in np.asarray(there)]
        for sensor, there in inside.items()
    }
    found[Sensor.SHADOW] = [
        Outcome.HIDDEN if outcome == Outcome.READ and behind else outcome
        for outcome, behind in zip(found[Sensor.SHADOW], np.asarray(hidden), strict=True)
    ]
    return found


@eqx.filter_jit
def _visible(places: Place, seen: Views) -> tuple[dict[Sensor, Any], Any]:
    def at(one: Place) -> tuple[dict[Sensor, Any], Any]:
        shadow = shadow_of(one.tip, one.lamp)
        edge = optics.cone_contour(beam_of(one), WALL, points=_EDGE).point
        marks = jnp.stack([one.spot, one.tip, shadow])
        by_centre = _in_view(seen.centre, jnp.concatenate([marks, edge]))
        inside = {
            Sensor.SPOT: jnp.all(by_centre[3:]),
            Sensor.SHADOW: by_centre[1] & by_centre[2],
            Sensor.STEREO: jnp.all(_in_view(seen.left, marks[:2]))
            & jnp.all(_in_view(seen.right, marks[:2])),
        }
        return inside, _hides(one, seen.centre, shadow)

    return jax.vmap(at)(places)


def _in_view(camera: Any, points: Any) -> Any:
    """Whether points are in the window, centred on the first one, and not behind the iris, n."""
    pixels = camera.project(points)
    inside = jnp.abs(pixels - pixels[0]) < jnp.array([WIDTH_PX, HEIGHT_PX]) / 2
    # The transmittance behind the iris is 0.
    passes = True if isinstance(camera, optics.Microscope) else camera.transmittance(pixels) > 0
    return jnp.all(inside, axis=-1) & passes


def _hides(one: Place, camera: optics.Camera, point: Any) -> Any:
    """Whether the instrument lies between the camera and a point of the wall."""
    _, down = camera.ray(camera.project(point))
    back = jnp.linspace(0.0, RADIUS_MM, _SHAFT)[:, None]
    shaft = one.tip - back * one.axis - point
    aside = shaft - (shaft @ down)[:, None] * down
    return jnp.any(jnp.linalg.norm(aside, axis=-1) < TOOL_RADIUS_MM)
