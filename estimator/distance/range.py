"""What a spot becomes: a distance, its standard deviation, and what to know about it."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np


class RangeFlag(Enum):
    """What to know before a distance is believed.

    AMBIGUOUS: other distances (`Range.others_mm`) explain the spot as well. OUT_OF_RANGE: the model
    has no such spot (the distance is NaN), or only with the tip behind the wall (it is negative).
    """

    NONE = "none"
    AMBIGUOUS = "ambiguous"
    OUT_OF_RANGE = "out_of_range"


@dataclass(frozen=True, kw_only=True, eq=False)
class TipPose:
    """Tip and axis of the beam in the eye frame.

    Attributes:
        tip_mm: S, (3,).
        axis: unit vector from the tip towards the wall, (3,).
        distance_mm: |SO|.
    """

    tip_mm: np.ndarray
    axis: np.ndarray
    distance_mm: float


@dataclass(frozen=True, kw_only=True, eq=False)
class Range:
    """A distance.

    Attributes:
        distance_mm: d = |SO|, along the beam; NaN where the model has no such spot.
        sigma_mm: its standard deviation, from the spot's and the calibration's covariance; NaN if
            the spot's mode measures none. What the model neglects is not in it.
        flag: what to know before it is believed.
        others_mm: other distances that explain the spot as well.
        poses: of `exact`: the best pose and its mirror image (the incidence reversed).
    """

    distance_mm: float
    sigma_mm: float
    others_mm: tuple[float, ...] = ()
    poses: tuple[TipPose, ...] = ()

    @property
    def flag(self) -> RangeFlag:
        """Derived from the distances."""
        if not self.distance_mm >= 0:
            return RangeFlag.OUT_OF_RANGE
        return RangeFlag.AMBIGUOUS if self.others_mm else RangeFlag.NONE
