"""The distance of a spot, its standard deviation, and the reason if it is doubtful."""

import math
from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import ArrayLike

from eyespot.formats.spot import Reason


class WallMemory(Enum):
    """What the mode pixels knew of the wall when it fitted a frame; NONE in the other modes."""

    NONE = ""
    NEW = "new"
    KNOWN = "known"
    MOVED = "moved"
    DROPPED = "dropped"

    @property
    def meaning(self) -> str:
        """What was done, and what it means for the distance, in a sentence or two."""
        return _MEMORIES[self]


_MEMORIES = {
    WallMemory.NONE: "The mode does not learn the wall.",
    WallMemory.NEW: "The frame is the first of its wall and was fitted by itself.",
    WallMemory.KNOWN: "Earlier frames showed the wall where it is.",
    WallMemory.MOVED: "The wall has moved in the image, and what earlier frames showed of it was "
    "moved with it. If the microscope has drifted, the eye is no longer where the microscope file "
    "says; the standard deviations contain that.",
    WallMemory.DROPPED: "The wall is not the one that earlier frames showed, or it has moved too "
    "far. The frame was fitted by itself.",
}


@dataclass(frozen=True, kw_only=True, eq=False)
class TipPose:
    """Tip and axis of the beam in the eye frame.

    Attributes:
        tip_mm: S, (3,).
        axis: unit vector from the tip towards the wall, (3,).
        covariance: 5 x 5, of the tip (x, y, z; mm) and of the axis's turns towards `across`, rad;
            None if unknown.
        across: two unit vectors across the axis, (2, 3); None without a covariance.
    """

    tip_mm: np.ndarray
    axis: np.ndarray
    distance_mm: float
    covariance: np.ndarray | None = None
    across: np.ndarray | None = None

    def less(self, tip_mm: ArrayLike, axis: ArrayLike) -> np.ndarray:
        """How far this pose is from another tip and axis, in the covariance's five coordinates."""
        assert self.across is not None, "a pose without errors has no such coordinates"
        turns = self.across @ (self.axis - np.asarray(axis))
        return np.concatenate([self.tip_mm - np.asarray(tip_mm), turns])

    def chi_squared(
        self, tip_mm: ArrayLike, axis: ArrayLike, *, part: slice = slice(None)
    ) -> float:
        """Square of the Mahalanobis distance from another tip and axis, in some coordinates."""
        assert self.covariance is not None, "a pose without errors has no such distance"
        off = self.less(tip_mm, axis)[part]
        return float(off @ np.linalg.solve(self.covariance[part, part], off))


@dataclass(frozen=True, kw_only=True, eq=False)
class Range:
    """A distance.

    Attributes:
        distance_mm: d = |SO|, along the beam; NaN where the model has no such spot.
        sigma_mm: its standard deviation, from the covariances of the spot and the calibration; NaN
            if the spot's mode measures none. Errors of the model itself are not included.
        sigma_image_mm: of `exact`: the part of the spot's and the axis's covariances in `sigma_mm`.
        poses: of `exact`: the best pose and its mirror image (the incidence reversed); of the mode
            pixels: the pose.
        chi_squared: of the mode pixels, per cell: 1 where beam, wall and camera explain the light.
        bound_mm: of the mode pixels: the least standard deviation that noise, texture and priors
            allow on a wall that nobody knows (Cramér-Rao).
        missing: why there is no distance, if there is none or it is negative.
    """

    distance_mm: float
    sigma_mm: float
    others_mm: tuple[float, ...] = ()
    poses: tuple[TipPose, ...] = ()
    sigma_image_mm: float = math.nan
    chi_squared: float = math.nan
    bound_mm: float = math.nan
    missing: Reason = Reason.OUT_OF_RANGE
    wall: WallMemory = WallMemory.NONE

    @property
    def flag(self) -> Reason | None:
        """Why there is no distance, or it is doubtful; None if all is well."""
        if not self.distance_mm >= 0:
            return self.missing
        return Reason.AMBIGUOUS if self.others_mm else None
