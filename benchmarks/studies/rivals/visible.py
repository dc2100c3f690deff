"""Which sensors can see their marks: the window, the iris, and the instrument in front."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import optics
from benchmarks.studies.rivals.findings import Outcome, Sensor
from benchmarks.studies.rivals.sensors import WALL, shadow_of
from benchmarks.studies.rivals.setup import (
    HEIGHT_PX,
    RADIUS_MM,
    TOOL_RADIUS_MM,
    WIDTH_PX,
    Place,
    Views,
    beam_of,
)

_EDGE = 32  # points of a spot's edge that must be in view
_SHAFT = 200  # points of the shaft's axis


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
