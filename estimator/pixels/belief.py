"""One explanation of the frames so far, and which explanations stay possible."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float

from estimator.image import Outline
from estimator.pixels.frame_model import lit
from estimator.pixels.frame_state import SHIFT, FrameState, Linear
from estimator.pixels.solution import Solution
from estimator.pixels.solver import Solver
from estimator.pixels.wall_motion import STILL, WallMotion

_UNDECIDED = 16.0
"""Difference of -2 log likelihoods that keeps a second pose possible: four standard deviations."""
_SAME = 3.0  # standard deviations within which two poses are one
_CALMS = 0.9  # of the shake that is expected, from frame to frame
_MOVES_ON_PX = 4.0  # of the wall from frame to frame; a microscope shakes by one or two
_DRIFTED_PX, _SURELY = 1.0, 3.0
"""Least drift of the wall since the first frame that is worth a word: px, standard deviations."""
_STAYS_PX = 0.1  # shift of a wall that keeps still; one that moved may move as far again


@dataclass(frozen=True, eq=False)
class Belief:
    """One explanation of the frames so far.

    Attributes:
        solver: of the window and with the wall's texture.
        kept: frames that are fitted again with each new one.
        solution: of the newest frame and those that were kept then.
        learnt_px2: `lit_px2` when the texture was learnt.
        surprise: mean square of the newest frame's cells less what all else says of them, in
            variances; see `frame_fit.Surprise`.
        lost: whether the newest frame shows another wall than the earlier ones or the reference.
        step: motion of the wall in the image since the frame before.
        shake_before_px: `shake_px` of the frame before.
    """

    solver: Solver
    kept: list[tuple[FrameState, Linear]]
    solution: Solution
    learnt_px2: float
    surprise: float = 1.0
    lost: bool = False
    step: WallMotion = STILL
    shake_before_px: float = 0.0

    @property
    def newest(self) -> FrameState:
        """The newest frame."""
        return self.solution.frames[-1]

    @cached_property
    def unlikelihood(self) -> float:
        """-2 log likelihood of all frames; a cell that is not trusted has a price, too."""
        return self.solver.unlikelihood_of(self.solution)

    @cached_property
    def sigmas(self) -> Float[np.ndarray, "5"]:
        """Standard deviations of the newest frame's pose."""
        return np.sqrt(np.diag(self.solution.newest_covariance))

    @cached_property
    def shift_variance_px2(self) -> float:
        """Variance of the newest frame's shift, of both sides together."""
        return float(np.trace(self.solution.newest_states(SHIFT)))

    @property
    def way_px(self) -> float:
        """How far the wall has moved in the image since the frame before.

        Less what errors of the shifts, of this frame and of that one, look like: a wall of which
        little is seen would move on, and ever farther, by its errors.
        """
        middle = self.newest.cells.motion.image_px(self.solver.window.middle_px)
        way = self.step.image_px(middle) - middle
        return math.sqrt(max(float(way @ way) - 2.0 * self.shift_variance_px2, 0.0))

    @property
    def shake_px(self) -> float:
        """How far the image may jump from frame to frame, as it did of late."""
        return max(min(self.way_px, _MOVES_ON_PX), _CALMS * self.shake_before_px)

    @property
    def shift_sigma_px(self) -> float:
        """Standard deviation of the wall's shift in the next frame."""
        return _STAYS_PX + self.shake_px

    @property
    def expected_motion(self) -> WallMotion:
        """Of the wall in the next frame: it moves on as it did, unless it only shakes."""
        motion = self.newest.cells.motion
        return self.step.after(motion) if self.way_px > _MOVES_ON_PX else motion

    @property
    def outline(self) -> Outline:
        """The half-maximum ellipse of the newest frame's light, good to a part of a cell."""
        window = self.solver.window
        light = self.solver.model.light(self.newest, self.solution.own)
        places = window.centres().reshape(-1, 2)[lit(light)]
        middle = self.newest.cells.motion.image_px(places.mean(axis=0))
        # Half of an axis is twice the standard deviation along it.
        variances, axes = np.linalg.eigh(4.0 * np.cov(places.T))
        semi_minor, semi_major = np.sqrt(variances).tolist()
        x, y = middle.tolist()
        angle = math.atan2(axes[1, 1], axes[0, 1])
        return Outline(x, y, semi_major, semi_minor, angle, measured=False)

    def drift(self, frame: FrameState) -> Float[np.ndarray, "2"]:
        """How far the wall has moved in the image from the map's begin to a frame, px."""
        middle = self.solver.window.middle_px
        return frame.cells.motion.image_px(middle) - middle

    @property
    def drifted(self) -> bool:
        """Whether the wall has moved since the map's begin, beyond what may be an error."""
        way = math.hypot(*self.drift(self.newest))
        return way > max(_DRIFTED_PX, _SURELY * math.sqrt(self.shift_variance_px2))

    def differs(self, other: Belief) -> bool:
        """Whether the newest pose is another one."""
        mine, its = self.newest.pose, other.newest.pose
        turned = mine.axis - its.axis
        change = np.array([mine.distance - its.distance, turned @ its.first, turned @ its.second])
        return bool((np.abs(change) > _SAME * other.sigmas[2:]).any())


def lit_px2(solver: Solver, solution: Solution) -> float:
    """Area of the window's wall that any frame of a solution lights."""
    seen = [lit(solver.model.light(frame, solution.own)) for frame in solution.frames]
    return float(np.count_nonzero(np.any(seen, axis=0))) * solver.window.side**2


def distinct(beliefs: list[Belief]) -> list[Belief]:
    """The best explanation, and others that are different and nearly as good."""
    if len(beliefs) < 2:  # a likelihood takes some milliseconds
        return beliefs
    best, *others = sorted(beliefs, key=lambda one: one.unlikelihood)
    kept = [best]
    for belief in others:
        near = belief.unlikelihood - best.unlikelihood < _UNDECIDED
        if near and all(belief.differs(other) for other in kept):
            kept.append(belief)
    return kept
