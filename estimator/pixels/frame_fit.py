"""Fits the newest frame. Cells with other light have little weight, and the wall may have moved."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from estimator.pixels.cells import CellLight
from estimator.pixels.frame_state import FrameState, Linear
from estimator.pixels.registration import registered
from estimator.pixels.solution import Solution
from estimator.pixels.solver import Solver
from estimator.pixels.wall_motion import WallMotion

STEPS = 8
_STEPS_AGAIN = 4
_FAR = 4.0  # a cell this far from what all else says of it, in standard deviations, has other light
_MOVED = 1.2
"""Surprise above which the wall may have moved. It is 1 where nothing has moved, with a standard
deviation of 0.05; parts of the wall that come into the light may be a surprise, too."""
_SURE = 16.0  # -2 log likelihood: four standard deviations
_SHIFTED_PX = 0.1  # of the wall, after which a frame's cells are cut anew


def robust_fit(
    solver: Solver,
    kept: list[tuple[FrameState, Linear]],
    frame: FrameState,
    own: Float[np.ndarray, "q"],
) -> tuple[Solution, float]:
    """A solution in which cells with other light have little weight, and its `Belief.surprise`."""
    solution = solver.solve(kept, frame, own, steps=STEPS)
    far = np.abs(solution.strange(len(kept)))
    used = solution.linear[-1].weight > 0
    surprise = float(np.sum(np.minimum(far, _FAR) ** 2) / max(np.count_nonzero(used), 1))
    if (far <= _FAR).all():
        return solution, surprise
    # The weight of Geman and McClure: a cell's pull falls with the cube of its distance.
    trust = np.where(far > _FAR, (_FAR / np.maximum(far, _FAR)) ** 4, 1.0)
    *earlier, newest = zip(solution.frames, solution.linear, strict=True)
    again = solver.solve(earlier, newest[0], solution.own, steps=_STEPS_AGAIN, trust=trust)
    return again, surprise


def fit_wherever(
    solver: Solver,
    kept: list[tuple[FrameState, Linear]],
    frame: FrameState,
    own: Float[np.ndarray, "q"],
    cells: Callable[[WallMotion], CellLight],
) -> tuple[Solution, float, bool]:
    """As `robust_fit`, wherever the wall is now.

    Args:
        solver: of the window.
        kept: earlier frames with their models.
        frame: the newest one, where its wall is expected.
        own: changes of the beam's own parameters.
        cells: the newest frame's light after a motion of the wall.

    Returns:
        The solution, its surprise, and whether the wall is lost: the frame is more likely by itself
        than with the earlier ones.
    """
    solution, surprise = robust_fit(solver, kept, frame, own)
    lost = False
    if surprise > _MOVED:
        before = solver.unlikelihood(kept, own)
        alone, _ = robust_fit(solver, [], replace(frame, grain=None), own)
        known, variance = solver.known([line for _, line in kept])
        step = registered(alone.linear[0], known, variance, solver.window)
        if step is not None:
            moved = replace(frame, cells=cells(frame.cells.motion.after(step)))
            again, less = robust_fit(solver, kept, moved, own)
            if solver.unlikelihood_of(again) < solver.unlikelihood_of(solution) - _SURE:
                solution, surprise = again, less
        together = solver.unlikelihood_of(solution) - before
        lost = together > solver.unlikelihood_of(alone) + _SURE
    newest = solution.frames[-1]
    if math.hypot(*newest.shift) > _SHIFTED_PX:
        motion = newest.cells.motion.after(WallMotion(*newest.shift))
        newest = replace(newest, cells=cells(motion), shift=(0.0, 0.0))
        solution.frames[-1] = newest
        solution.linear[-1] = solver.linear(newest, solution.own)
    return solution, surprise, lost
