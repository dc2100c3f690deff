"""What an error of the blur, or of a saturated spot's border, would do to a pose.

A blur moves the half maximum of a spot of radius R inwards by its variance over 2 R. The blur that
is fitted has a shape between a few usual ones and is the same all over the window, and what is
known of the wall is blurred as well. So this shift is known only about as well as it is large, and
its error is alike in all frames: it does not average out. Where the wall's reflectance grows to one
side, its blur brings light from there, and the edge moves that way by the variance times the growth
of the logarithm.
"""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float

from estimator.pixels.beam import POSE
from estimator.pixels.cells import COUNT
from estimator.pixels.frame_model import lit
from estimator.pixels.frame_state import BLUR
from estimator.pixels.saturation import BLOOM_DOUBT_PX
from estimator.pixels.solution import Solution
from estimator.pixels.solver import Solver
from estimator.pixels.texture import Texture

_WIDE_PX2 = 0.5  # variance of a blur, below which its errors do not matter
_SHARE = 2.0
"""Error of the shift, over the shift. On rendered cones out of focus by 2 and 3 mm at NA 0.04 the
distance was off by up to 0.5 of what the whole shift makes of it in first frames, by up to 1.1 on
printed paper and by 1.5 to 2.6 on a retina in the frames that follow."""
_ONE_WAY, _MOST_PX2 = 0.7, 4.0
"""How much wider a blur is along one direction, over its variance, and up to which variance, px²:
where the view moves during the exposure, by the whole of it. A motion by seven pixels has 4 px²; a
wider blur is that of a camera out of focus."""


def edge_covariance(solver: Solver, solution: Solution) -> Float[np.ndarray, "5 5"]:
    """What such errors may have done to the newest pose, in the terms of `POSE`.

    Args:
        solver: of the solution.
        solution: with the newest frame last.
    """
    newest = solution.frames[-1]
    if newest.blur_px2 < _WIDE_PX2 and not newest.saturated:
        return np.zeros((POSE, POSE))
    shifts = np.array([_changes(solver, solution, k) for k in range(len(solution.frames))])
    # The edge may be shifted all round, by an oval, or to a side, or wider along one direction.
    pulls = [solution.answer(list(shifts[:, k]))[:POSE] for k in range(shifts.shape[1])]
    # Where the spot moves on, the wall grows otherwise.
    still = [np.zeros_like(shifts[0, 0])] * (len(shifts) - 1)
    pulls += [solution.answer([*still, shifts[-1, k]])[:POSE] for k in (3, 4)]
    return np.sum([np.outer(pull, pull) for pull in pulls], axis=0)


def _changes(solver: Solver, solution: Solution, k: int) -> Float[np.ndarray, "7 n"]:
    """How frame k's log light changes by each of these errors."""
    frame, by_blur = solution.frames[k], solution.linear[k].slopes[BLUR]
    light = solver.model.light(frame, solution.own)
    side, spot = solver.window.side, lit(light)
    radius = side * math.sqrt(np.count_nonzero(spot) / math.pi)
    light = np.exp(solver.model.log_light(frame, light))
    steep = np.hypot(*np.gradient(light.reshape(COUNT, COUNT), side)).ravel()
    shift = _SHARE * frame.blur_px2 / (2.0 * radius) + BLOOM_DOUBT_PX * frame.saturated
    x, y = solver.window.centres().reshape(-1, 2).T
    angle = np.arctan2(y - y[spot].mean(), x - x[spot].mean())
    aside = frame.blur_px2 * _growth(solver.texture, radius, solver.beam.scale_mm_px)
    outwards = steep / light
    oval = np.stack([np.cos(2 * angle), np.sin(2 * angle)])
    to_a_side = aside * np.stack([np.cos(angle), np.sin(angle)])
    shifts = np.concatenate([shift * np.ones((1, angle.size)), shift * oval, to_a_side])
    one_way = _ONE_WAY * min(frame.blur_px2, _MOST_PX2)
    return np.concatenate([outwards * shifts, one_way * by_blur * oval])


def _growth(texture: Texture, radius_px: float, scale_mm_px: float) -> float:
    """Standard deviation of the growth of log reflectance across a spot, 1/px."""
    across = 2.0 * radius_px
    # A blurred wall looks more even than it is.
    least = Texture.usual()
    return math.sqrt(max(one.variogram(across * scale_mm_px) for one in (texture, least))) / across
