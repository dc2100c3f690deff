"""Fits the newest frame. Cells with other light have little weight, and the wall may have moved.

A frame may be noisier than the microscope file says: by JPEG, by a Bayer pattern, or by a line that
comes into the light in the middle of cells. So where a frame surprises, it and the earlier ones
have less weight. The wall is another one only if that explains the frame better.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from estimator.pixels.cells import CellLight
from estimator.pixels.frame_state import FrameState, Linear
from estimator.pixels.registration import registered
from estimator.pixels.solution import Solution
from estimator.pixels.solver import Solver
from estimator.pixels.wall_motion import STILL, WallMotion

STEPS = 8
_STEPS_AGAIN = 4
_FAR = 4.0  # a cell this far from what all else says of it, in standard deviations, has other light
_UNUSUAL = 4.0  # standard deviations of a surprise
_GROWN = 1.2  # growth of a surprise's square that asks where the wall is
_SURE = 16.0  # -2 log likelihood: four standard deviations
_SHIFTED_PX = 0.1  # of the wall, after which a frame's cells are cut anew


class Surprise(NamedTuple):
    """How far cells of the newest frame are from what all else says of them.

    Attributes:
        square: mean square, in variances.
        sigmas: how far that is from 1, in its standard deviations.
    """

    square: float
    sigmas: float

    @classmethod
    def of(cls, far: Float[np.ndarray, "n"]) -> Surprise:
        """Of distances in standard deviations."""
        square = float(np.mean(np.square(far))) if far.size else 1.0
        return cls(square, (square - 1.0) * math.sqrt(0.5 * far.size))

    @property
    def unusual(self) -> bool:
        """Whether chance alone would hardly do that."""
        return self.sigmas > _UNUSUAL


def robust_fit(
    solver: Solver,
    kept: list[tuple[FrameState, Linear]],
    frame: FrameState,
    own: Float[np.ndarray, "q"],
) -> tuple[Solution, Surprise]:
    """A solution in which cells with other light have little weight, and the surprise."""
    solution = solver.solve(kept, frame, own, steps=STEPS)
    far = np.abs(solution.strange(len(kept)))
    looked_at = solution.linear[-1].weight > 0
    if kept:  # what comes into the light is new, not a surprise
        before = np.sum([line.weight for _, line in kept], axis=0)
        looked_at &= before * solver.texture.variance > 1.0
    surprise = Surprise.of(np.minimum(far, _FAR)[looked_at])
    # The weight of Geman and McClure: a cell's pull falls with the cube of its distance.
    trust = (_FAR / np.maximum(far, _FAR)) ** 4
    # Where the wall has moved, the surprise is an error of its place, not noise.
    still = frame.cells.motion == STILL
    noise = surprise.square if surprise.unusual and still else 1.0
    if noise == 1.0 and (trust == 1.0).all():
        return solution, surprise
    *earlier, newest = zip(solution.frames, solution.linear, strict=True)
    earlier = [(state, line._replace(weight=line.weight / noise)) for state, line in earlier]
    again = solver.solve(earlier, newest[0], solution.own, steps=_STEPS_AGAIN, trust=trust / noise)
    return again, surprise


def fit_wherever(
    solver: Solver,
    kept: list[tuple[FrameState, Linear]],
    frame: FrameState,
    own: Float[np.ndarray, "q"],
    cells: Callable[[WallMotion], CellLight],
    *,
    usual: float,
) -> tuple[Solution, float, bool]:
    """As `robust_fit`, wherever the wall is now.

    Args:
        solver: of the window.
        kept: earlier frames with their models.
        frame: the newest one, where its wall is expected.
        own: changes of the beam's own parameters.
        cells: the newest frame's light after a motion of the wall.
        usual: the square of the surprise of the frame before. No other place is looked for where
            that has hardly grown, because each search takes as long as two frames.

    Returns:
        The solution, the square of its surprise, and whether the wall is lost: the frame is more
        likely by itself than with the earlier ones.
    """
    solution, surprise = robust_fit(solver, kept, frame, own)
    lost = False
    if surprise.unusual and surprise.square > _GROWN * usual:
        alone, _ = robust_fit(solver, [], replace(frame, grain=None), own)
        known, variance = solver.known([line for _, line in kept])
        step = registered(alone.linear[0], known, variance, solver.window)
        if step is not None:
            moved = replace(frame, cells=cells(frame.cells.motion.after(step)))
            again, less = robust_fit(solver, kept, moved, own)
            if _unlikelihood(solver, again) < _unlikelihood(solver, solution) - _SURE:
                solution, surprise = again, less
        lost = _unlikelihood(solver, solution) > _unlikelihood(solver, alone) + _SURE
    newest = solution.frames[-1]
    if math.hypot(*newest.shift) > _SHIFTED_PX:
        motion = newest.cells.motion.after(WallMotion(*newest.shift))
        newest = replace(newest, cells=cells(motion), shift=(0.0, 0.0))
        solution.frames[-1] = newest
        solution.linear[-1] = solver.linear(newest, solution.own)
    return solution, surprise.square, lost


def _unlikelihood(solver: Solver, solution: Solution) -> float:
    """-2 log likelihood of the newest frame, given the earlier ones."""
    *earlier, _ = zip(solution.frames, solution.linear, strict=True)
    before = solver.unlikelihood(earlier, solution.own) if earlier else 0.0
    return solver.unlikelihood_of(solution) - before
