"""A measured spot, or why there is none."""

import math
from dataclasses import dataclass, field
from enum import Enum
from typing import Literal, NamedTuple, final

import numpy as np

PARAMETERS = ("x", "y", "semi_major", "semi_minor", "angle")
"""Order of the rows and columns of `Spot.covariance`."""


class Reason(Enum):
    """Why a frame has no spot, or a spot no distance or a doubtful one: the spots file's list.

    `INTERNAL_ERROR` is a bug of the measurement that the frame met; all others are findings.
    """

    NONE_FOUND = "none_found"
    CLIPPED = "clipped"
    TOO_SMALL = "too_small"
    TOO_LARGE = "too_large"
    TOO_FAINT = "too_faint"
    SATURATED = "saturated"
    OCCLUDED = "occluded"
    AMBIGUOUS = "ambiguous"
    FIELD_STOP = "field_stop"
    UNREADABLE = "unreadable"
    INTERNAL_ERROR = "internal_error"
    OUT_OF_RANGE = "out_of_range"
    MISFIT = "misfit"
    GHOST = "ghost"
    NOT_CONVERGED = "not_converged"

    @property
    def meaning(self) -> str:
        """What was found, and what to do, in a sentence or two."""
        return _MEANINGS[self]


_MEANINGS = {
    Reason.NONE_FOUND: "Nothing bright in the frame has the outline of a spot. Look at the frame. "
    "Switch the light on, or expose longer.",
    Reason.CLIPPED: "The border of the image cuts the spot. Move the window or the spot.",
    Reason.TOO_SMALL: "The spot is smaller than can be measured. Withdraw the tip, or use a finer "
    "scale.",
    Reason.TOO_LARGE: "The spot is larger than allowed for this image. Approach the wall, or use a "
    "coarser scale.",
    Reason.TOO_FAINT: "The spot hardly exceeds the noise and texture round it. Expose longer, or "
    "dim the other light.",
    Reason.SATURATED: "So much of the spot is at full scale that its outline is not in the image. "
    "Shorten the exposure.",
    Reason.OCCLUDED: "Too little of the outline is visible: an instrument, a shadow or a "
    "reflection hides it.",
    Reason.AMBIGUOUS: "Two places could be the spot, or two distances explain it. Click the spot "
    "(console), or cover the other light; behind a lens only motion tells distances apart.",
    Reason.FIELD_STOP: "A large, round disc in the middle of a dark frame may be the camera's own "
    "field. If it is the spot, click it (console), begin with a smaller one, or light the wall.",
    Reason.UNREADABLE: "The frame could not be decoded; the note says why. Record it again, or in "
    "another encoding.",
    Reason.INTERNAL_ERROR: "The measurement failed. This is a bug; please report the frame.",
    Reason.OUT_OF_RANGE: "The model has no such spot in front of the wall, or it needs the robot's "
    "axis and there is none. Check the calibration, the microscope file and the poses.",
    Reason.MISFIT: "The light is not that of the calibrated beam on a wall. Look for reflexes, a "
    "second light or another lens; check the calibration and the camera's noise.",
    Reason.GHOST: "A second, fainter image of the spot moves with it and pulls the distance. Look "
    "for reflexes of a cover glass, of a lens or of the eye, and turn or remove what makes them.",
    Reason.NOT_CONVERGED: "No pose was found that explains the light. The next frame is fitted "
    "anew.",
}


class Outline(NamedTuple):
    """Where a spot is in an image, and how large: fields of `Spot`, with other defaults.

    Attributes:
        edge_width_px: 0 where it is not known.
        measured: whether it is that of a spot, and not of something bright that may be one.
    """

    x_px: float
    y_px: float
    semi_major_px: float
    semi_minor_px: float
    angle_rad: float
    edge_width_px: float = 0.0
    measured: bool = True


class OwnHalf(NamedTuple):
    """The contour where each side's light is half of its own, against that of half of the peak.

    They differ where the light slopes across the spot.

    Attributes:
        right_px, down_px: shift of the centre.
        growth: of the axes.
        more_variance_px2: what the variance of either coordinate of the centre gains.
        less_growth_variance: what that of the axes' growth loses.
    """

    right_px: float = 0.0
    down_px: float = 0.0
    growth: float = 1.0
    more_variance_px2: float = 0.0
    less_growth_variance: float = 0.0


EVEN_LIGHT = OwnHalf()
"""Both contours are the same."""


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class Spot:
    """Ellipse of a spot in image coordinates (pixel centres at integers), with its quality.

    A value that a mode does not measure is NaN.

    Attributes:
        x_px: centre, to the right, px.
        y_px: centre, downwards, px.
        semi_major_px: half of the longer axis, px.
        semi_minor_px: half of the shorter axis, px.
        angle_rad: semi-major axis from +u (right) towards +v (down), in (-pi/2, pi/2].
        covariance: 5x5, order `PARAMETERS`, px and rad.
        edge_width_px: standard deviation of the Gaussian-blurred step that has the edge's slope
            at half maximum, px.
        coverage: fraction of the contour's length on which an edge is visible.
        inlier_fraction: fraction of the visible edges that belong to the ellipse.
        saturated: fraction of the spot's pixels at full scale in the channel measured.
        own_half: where each side's light is half of its own.
    """

    x_px: float
    y_px: float
    semi_major_px: float
    semi_minor_px: float
    angle_rad: float
    covariance: np.ndarray
    edge_width_px: float
    coverage: float
    inlier_fraction: float
    saturated: float
    own_half: OwnHalf = EVEN_LIGHT

    @property
    def ellipse(self) -> tuple[float, float, float, float, float]:
        """Its five parameters, in the order of `PARAMETERS`, px and rad."""
        return self.x_px, self.y_px, self.semi_major_px, self.semi_minor_px, self.angle_rad

    @property
    def outline(self) -> Outline:
        """Its ellipse and how wide its edge is."""
        return Outline(*self.ellipse, self.edge_width_px)

    @property
    def sigma_semi_minor_px(self) -> float:
        """Standard deviation of the semi-minor axis, px."""
        return math.sqrt(self.covariance[3, 3])


@final
@dataclass(frozen=True)
class NoSpot:
    """A frame without a measurable spot, with the reason; falsy.

    Attributes:
        significance: of a spot that is `TOO_FAINT`: its peak above the background over the standard
            deviation round it; NaN for other reasons.
    """

    reason: Reason
    significance: float = field(default=math.nan, compare=False, repr=False)

    def __bool__(self) -> Literal[False]:
        """Always false, so that `if result:` means that there is a spot."""
        return False
