"""Where the wall's map lies in a frame in which the wall has moved.

A frame's light less its model is the wall's log reflectance there, but for what a small change of
the pose or of the ambient light makes of it. So that change is fitted at every shift and turn that
is tried. Cells that the map does not know have the variance of the wall, so that it does not pay
to leave the map.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from jaxtyping import Float
from scipy.ndimage import map_coordinates
from scipy.optimize import minimize

from estimator.pixels.cells import COUNT, SIDES, Window
from estimator.pixels.frame_state import Linear
from estimator.pixels.wall_motion import WallMotion

_FARTHEST = 6  # cells; 1 mm/s is two or three of them from frame to frame
_TURN = 0.02  # standard deviation of the turn from frame to frame, rad
_SURE = 16.0  # gain of -2 log likelihood: four standard deviations
_MIDDLE = 0.5 * (COUNT - 1)
_CELLS = 0.5 * COUNT * SIDES
"""Columns and rows from the window's middle."""


def farthest_px(window: Window) -> float:
    """The longest shift that is searched for."""
    return float(_FARTHEST * window.side)


def registered(
    line: Linear,
    known: Float[np.ndarray, "n"],
    variance: Float[np.ndarray, "n"],
    window: Window,
) -> WallMotion | None:
    """The motion of the wall since the cells of the map were where the frame's are now.

    None if the map is not more likely elsewhere, or only too far away.

    Args:
        line: the frame's model on the cells, fitted without the map.
        known: log reflectance of the cells by earlier frames.
        variance: of `known`.
        window: the cells.
    """
    used = line.weight > 0
    residual, slopes = line.residual[used], line.slopes[:, used]
    noise, unknown = 1.0 / line.weight[used], float(variance.max())
    shape = COUNT, COUNT

    def misfit(moved: Float[np.ndarray, "3"], order: int) -> float:
        ways = WallMotion(turn=float(moved[2])).ways
        columns, rows = ways.T @ (_CELLS[:, used] - moved[:2, None]) + _MIDDLE
        at = np.stack([rows, columns])
        value = map_coordinates(known.reshape(shape), at, order=order, cval=0.0)
        doubt = map_coordinates(variance.reshape(shape), at, order=1, cval=unknown)
        weight = 1.0 / (noise + doubt)
        off, weighted = residual - value, slopes * weight
        pull = weighted @ off
        explained = pull @ np.linalg.pinv(weighted @ slopes.T, hermitian=True) @ pull
        turned = (moved[2] / _TURN) ** 2
        return float(off @ (weight * off) - explained - np.sum(np.log(weight)) + turned)

    best = min(_whole_cells(), key=lambda moved: misfit(moved, 0))
    steps = np.vstack([np.zeros(3), 0.5 * np.eye(3) * [1.0, 1.0, 2.0 / COUNT]])
    found = minimize(
        misfit, best, args=(3,), method="Nelder-Mead", options={"initial_simplex": best + steps}
    ).x
    gain = misfit(np.zeros(3), 3) - misfit(found, 3)
    if gain < _SURE or np.abs(found[:2]).max() > _FARTHEST + 1:
        return None
    return WallMotion.about(window.middle_px, window.side * found[:2], float(found[2]))


def _whole_cells() -> Iterator[Float[np.ndarray, "3"]]:
    along = range(-_FARTHEST, _FARTHEST + 1)
    return (np.array([column, row, 0.0]) for column in along for row in along)
