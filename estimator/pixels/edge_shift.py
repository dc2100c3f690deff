"""What an error of the blur would do to a pose.

A blur moves the half maximum of a spot of radius R inwards by its variance over 2 R. The blur that
is fitted has a shape between a few usual ones and is the same all over the window, and what is
known of the wall is blurred as well. So this shift is known only about as well as it is large, and
its error is alike in all frames: it does not average out.
"""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float

from estimator.pixels.beam import POSE
from estimator.pixels.blur import blurred
from estimator.pixels.cells import COUNT
from estimator.pixels.frame_state import FrameState
from estimator.pixels.solution import Solution
from estimator.pixels.solver import Solver

_WIDE_PX2 = 0.5  # variance of a blur, below which its errors do not matter
_SHARE = 2.0
"""Error of the shift, over the shift. On rendered cones out of focus by 2 and 3 mm at NA 0.04 the
distance was off by up to 0.5 of what the whole shift makes of it in first frames, by up to 1.1 on
printed paper and by 1.5 to 2.6 on a retina in the frames that follow."""


def blur_covariance(solver: Solver, solution: Solution) -> Float[np.ndarray, "5 5"]:
    """What errors of the blur may have done to the newest pose, in the terms of `POSE`.

    Args:
        solver: of the solution.
        solution: with the newest frame last.
    """
    if solution.frames[-1].blur_px2 < _WIDE_PX2:
        return np.zeros((POSE, POSE))
    shifts = np.array([_changes(solver, solution, frame) for frame in solution.frames])
    # The edge may be shifted all round, or by an oval.
    pulls = [solution.answer(list(shifts[:, k]))[:POSE] for k in range(shifts.shape[1])]
    return np.sum([np.outer(pull, pull) for pull in pulls], axis=0)


def _changes(solver: Solver, solution: Solution, frame: FrameState) -> Float[np.ndarray, "3 n"]:
    """How a frame's log light changes if its edge is shifted outwards, evenly or to an oval."""
    lit = solver.model.lit(frame, solution.own)
    side = solver.window.side
    radius = side * math.sqrt(np.count_nonzero(lit) / math.pi)
    light = solver.model.light(frame, solution.own)
    light = np.maximum(blurred(light, frame.blur_px2 / side**2, frame.kurtosis), 0.0)
    steep = np.hypot(*np.gradient(light.reshape(COUNT, COUNT), side)).ravel()
    shift = _SHARE * frame.blur_px2 / (2.0 * radius)
    x, y = solver.window.centres().reshape(-1, 2).T
    angle = np.arctan2(y - y[lit].mean(), x - x[lit].mean())
    evenly = shift * steep / (light + np.exp(frame.log_ambient))
    return evenly * np.stack([np.ones_like(angle), np.cos(2 * angle), np.sin(2 * angle)])
