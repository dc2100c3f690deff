"""What each sensor can reach: exact marks with stated noise, and with one wrong assumption."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd

import optics
from benchmarks.studies.rivals.sensors import (
    CONTOUR_PX,
    MARK_PX,
    WALL_PX,
    Known,
    Marks,
    Outcome,
    Sensor,
    Wrong,
    by_shadow,
    by_spot,
    by_stereo,
    marks_of,
    outcomes_at,
)
from benchmarks.studies.rivals.setup import RADIUS_MM, Numbers, Place, Views, place

_POINTS = 128
_LAMP_OFF_MM, _AXIS_OFF_DEG, _RADIUS_OFF_MM = 1.0, 1.0, 0.5
_DIRECTIONS = 4  # in which something is displaced
_AFFECTED = {Wrong.LAMP: (Sensor.SHADOW,)}


class Assumed(NamedTuple):
    """What is assumed at each place.

    Attributes:
        lamp: end of the light guide, mm.
        lower: by how much the wall's radius is taken too large, mm.
    """

    lamp: Numbers
    axis: Numbers
    lower: Numbers


def expected(
    path: str,
    seen: Views,
    pinholes: Views,
    *,
    eccentricities: np.ndarray,
    distances: np.ndarray,
    draws: int,
    seed: int,
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Rows of expected.csv and of wrong.csv for one path.

    The first are standard deviations of marks of the stated noise, with everything known; the
    second are errors of exact marks if one assumption is wrong, RMS over directions.

    Args:
        pinholes: cameras at the same places without a path.
        eccentricities: c, mm.
        distances: d, mm.
        draws: of the noise at each place.
    """
    every = [
        place(eccentricity=c, distance=d)
        for c in eccentricities.tolist()
        for d in distances.tolist()
    ]
    places = Place(*map(np.stack, zip(*every, strict=True)))
    true, outcomes = _marks(places, seen), outcomes_at(places, seen)
    right = Assumed(places.lamp, places.axis, np.zeros(len(every)))
    cases = {Wrong.PATH: [right], **_wrong(places, right)}
    # All in one batch, so that each kind of path is compiled once: noise, then wrong assumptions.
    assumed = [right] * draws + [one for several in cases.values() for one in several]
    batch = jax.tree.map(lambda *leaves: np.stack(leaves), *assumed)
    noise = _noise(true, draws, len(assumed), seed)
    read = {sensor: np.asarray(d) for sensor, d in _read(true, noise, batch, seen).items()}
    by_pinhole = read if path == "pinhole" else _read(true, noise, batch, pinholes)
    where = {"path": path, "c_mm": places.eccentricity, "d_mm": places.distance}
    noisy, biases, first = [], [], draws
    for sensor in Sensor:
        done = np.array(outcomes[sensor]) == Outcome.READ
        sigma = np.where(done, read[sensor][:draws].std(axis=0), np.nan)
        about = {"sensor": sensor, **where, "outcome": outcomes[sensor]}
        noisy.append(pd.DataFrame(about | {"sigma_mm": sigma}))
    for wrong, several in cases.items():
        part = slice(first, first + len(several))
        first = part.stop
        if wrong == Wrong.PATH and path == "pinhole":
            continue
        for sensor in _AFFECTED.get(wrong, tuple(Sensor)):
            values = by_pinhole[sensor] if wrong == Wrong.PATH else read[sensor]
            error = np.asarray(values)[part] - places.distance
            # Displacements in opposite directions have opposite effects; their size counts.
            size = error[0] if len(error) == 1 else np.sqrt(np.mean(error**2, axis=0))
            rows = pd.DataFrame({"sensor": sensor, **where, "wrong": wrong, "error_mm": size})
            biases.append(rows[np.array(outcomes[sensor]) == Outcome.READ])
    columns = ["sensor", "path", "wrong", "c_mm", "d_mm", "error_mm"]
    wrongs = pd.concat(biases, ignore_index=True)[columns]
    return pd.concat(noisy, ignore_index=True), wrongs


@eqx.filter_jit
def _marks(places: Place, seen: Views) -> Marks:
    return jax.vmap(lambda one: marks_of(one, seen, points=_POINTS))(places)


@eqx.filter_jit
def _read(marks: Marks, noise: Marks, assumed: Assumed, seen: Views) -> dict[Sensor, Any]:
    """Readings, cases x places: of marks (places) with noise (cases x places), as assumed."""

    def one(own: Marks, off: Marks, given: Assumed) -> dict[Sensor, Any]:
        own = jax.tree.map(jnp.add, own, off)
        known = Known(
            views=_lowered(seen, given.lower),
            radius=RADIUS_MM + given.lower,
            # The centre of a larger sphere lies higher above the pole.
            lamp=given.lamp - given.lower * jnp.array([0.0, 0.0, 1.0]),
            axis=given.axis,
        )
        return {
            Sensor.SPOT: by_spot(optics.ellipse_of_contour(own.contour), known),
            Sensor.SHADOW: by_shadow(own.tip, own.shadow, known),
            Sensor.STEREO: by_stereo(own.tip_pair, own.wall_pair, known),
        }

    return jax.vmap(jax.vmap(one), (None, 0, 0))(marks, noise, assumed)


def _lowered(seen: Views, lower: Any) -> Views:
    """The cameras in the frame of a larger sphere, whose pole lies lower; they stay in place."""
    return Views(
        *(
            eqx.tree_at(lambda c: c.pole_height, camera, camera.pole_height - lower)
            for camera in seen
        )
    )


def _noise(marks: Marks, draws: int, cases: int, seed: int) -> Marks:
    """Noise of the first cases; the others have none."""
    rng = np.random.default_rng(seed)
    sigma = Marks(CONTOUR_PX, MARK_PX, MARK_PX, MARK_PX, WALL_PX)

    def of(leaf: Any, s: float) -> np.ndarray:
        found = np.zeros((cases, *leaf.shape))
        found[:draws] = s * rng.standard_normal((draws, *leaf.shape))
        return found

    return jax.tree.map(of, marks, sigma)


def _wrong(places: Place, right: Assumed) -> dict[Wrong, list[Assumed]]:
    """Wrong assumptions, each in the directions in which it can be wrong."""
    off = math.tan(math.radians(_AXIS_OFF_DEG))
    return {
        Wrong.LAMP: [
            right._replace(lamp=places.lamp + aside)
            for aside in _aside(places.lamp_axis, _LAMP_OFF_MM)
        ],
        Wrong.AXIS: [
            right._replace(axis=_unit(places.axis + aside)) for aside in _aside(places.axis, off)
        ],
        Wrong.RADIUS: [right._replace(lower=right.lower + _RADIUS_OFF_MM)],
    }


def _aside(axes: np.ndarray, size: float) -> list[np.ndarray]:
    """Vectors across axes, in evenly spaced directions."""
    first, second = (np.asarray(v) for v in optics.perpendicular_frame(axes))
    angles = 2 * np.pi * np.arange(_DIRECTIONS) / _DIRECTIONS
    return [size * (math.cos(a) * first + math.sin(a) * second) for a in angles]


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)
