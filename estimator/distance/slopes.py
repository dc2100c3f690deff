"""Derivatives of a cone's distance by all that it is computed from, in NumPy."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from estimator.distance.tilted_cone import Eye, spot_image

_STEP = 1e-5  # of the differences, relative
_LEAST = 0.1  # of a quantity near zero, mm and 1/mm


class Slopes(NamedTuple):
    """Derivatives of the distance, mm.

    Attributes:
        size: by the size of the spot, per px.
        x: by its place, per px.
        y: by its place, per px.
        tilt: by the beam's axis, per rad: the root of the squares across it.
        of: by the quantities of `Eye`, per their unit.
    """

    size: float
    x: float
    y: float
    tilt: float
    of: dict[str, float]


def slopes_of(
    eye: Eye, *, axis: np.ndarray, point: np.ndarray, distance: float, by_area: bool
) -> Slopes:
    """Derivatives of `distance_of`, from those of the spot's size at the distance found.

    The size e depends on the distance d and on each quantity q, so that at a measured size
    dd/dq = -(de/dq)/(de/dd). The spot stays where it is seen.

    Args:
        eye: of one spot.
        axis: unit vector, (3,).
        point: O, (3,), mm.
        distance: d, mm.
        by_area: as of `distance_of`.
    """
    given = {
        "k": float(eye.k[0]),
        "b": float(eye.b[0]),
        "scale": eye.scale,
        "eye_radius": eye.eye_radius,
        "inverse_working_distance": eye.inverse_working_distance,
    }
    steps = {name: _STEP * max(abs(value), _LEAST) for name, value in given.items()}
    # Rows: as it is, farther, x, y, two turns of the axis, then each quantity of the eye.
    count = 6 + len(given)
    grid = {name: np.full(count, value) for name, value in given.items()}
    for row, name in enumerate(given, 6):
        grid[name][row] += steps[name]
    axes, distances = np.tile(axis, (count, 1)), np.full(count, distance)
    distances[1] += _STEP
    first, second = np.linalg.svd(axis[None])[2][1:]
    for row, side in ((4, first), (5, second)):
        axes[row] = (axis + _STEP * side) / math.hypot(1.0, _STEP)
    depth = 1 - eye.inverse_working_distance * (point[2] + eye.eye_radius)
    pixel = np.tile(np.array([point[0], -point[1]]) / (eye.scale * depth), (count, 1))
    pixel[2, 0] += 1.0
    pixel[3, 1] += 1.0
    varied = Eye(**grid, normal=eye.normal)
    seen = spot_image(varied, spot=varied.wall_point(pixel), axis=axes, distance=distances)
    size = seen.size(by_area=by_area)
    change = size - size[0]
    per_px = float(_STEP / change[1])
    moved = -per_px * change
    return Slopes(
        size=per_px,
        x=float(moved[2]),
        y=float(moved[3]),
        tilt=math.hypot(moved[4], moved[5]) / _STEP,
        of={name: float(moved[row] / steps[name]) for row, name in enumerate(given, 6)},
    )
