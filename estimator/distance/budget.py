"""What a distance is worth: its uncertainty by cause, in the terms of the GUM (JCGM 100:2008)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple, Self

_LEVEL = 0.95


class Cause(Enum):
    """What makes a distance uncertain."""

    IMAGE = "image"
    CALIBRATION = "calibration"
    TILT = "tilt"
    EYE_RADIUS = "eye_radius"
    VIEWING = "viewing"
    TOUCH = "touch"
    CLOCK = "clock"

    @property
    def meaning(self) -> str:
        """The cause in words."""
        return _MEANINGS[self]

    @property
    def kind(self) -> str:
        """Type of evaluation: A from repeated observations, B from what was stated.

        A fit contains both: its priors, such as the touch, are stated.
        """
        return {Cause.IMAGE: "A", Cause.CALIBRATION: "A, B"}.get(self, "B")


_MEANINGS = {
    Cause.IMAGE: "image noise and texture",
    Cause.CALIBRATION: "calibration",
    Cause.TILT: "model at this tilt",
    Cause.EYE_RADIUS: "eye radius",
    Cause.VIEWING: "viewing path",
    Cause.TOUCH: "touch",
    Cause.CLOCK: "pose age and clock",
}


class Part(NamedTuple):
    """The part of one cause.

    Attributes:
        cause: of the uncertainty.
        sigma_mm: its standard uncertainty, as part of the distance.
        freedom: its degrees of freedom.
        source: the quantity that the part comes from, or most of it.
        source_sigma: standard uncertainty of that quantity; NaN if it is no single number.
        unit: of that quantity.
    """

    cause: Cause
    sigma_mm: float
    freedom: float = math.inf
    source: str = ""
    source_sigma: float = math.nan
    unit: str = ""

    @property
    def remedy(self) -> str:
        """What halves it."""
        remedy = _TOUCH_REMEDY if self.source == "b" else _REMEDIES[self.cause]
        return remedy.format(
            source=self.source, half=f"{self.source_sigma / 2:.3g} {self.unit}".strip()
        )


_TOUCH_REMEDY = (
    "Know b to ± {half}: measure the touch better (--prior touch=MEAN,SIGMA), or fit more "
    "withdrawals; more frames of the same ones do not help where the touch decides."
)
_REMEDIES = {
    Cause.IMAGE: "Average four readings: of a tip at rest if the noise counts, of several places "
    "if the wall's texture does.",
    Cause.CALIBRATION: "Know {source} to ± {half}: four times as many frames in the fit, or a "
    "better prior.",
    Cause.TILT: "Know {source} to ± {half}, or take the model exact or area.",
    Cause.EYE_RADIUS: "Know the eye's radius to ± {half}, or calibrate in the eye (`eyespot fit "
    "--model eye`).",
    Cause.VIEWING: "Know {source} to ± {half}, or calibrate farther out in the eye (`eyespot fit "
    "--model eye`).",
    Cause.TOUCH: "Know the tip's distance at contact to ± {half}.",
    Cause.CLOCK: "Know {source} to ± {half}, or move at half the speed.",
}


@dataclass(frozen=True, kw_only=True)
class Budget:
    """What a distance is worth.

    Attributes:
        reading_mm: the distance by the model in use.
        correction_mm: to be added to it: minus the model's error at this c, d and tilt.
        parts: by cause; those that are known to be zero are left out.
        left_out: what is not assessed, in words.

    Example:
        >>> touch, noise = Part(Cause.TOUCH, 0.02), Part(Cause.IMAGE, 0.002, freedom=187)
        >>> budget = Budget.of(2.38, correction_mm=0.34, parts=[touch, noise])
        >>> low, high = budget.interval_mm
        >>> f"{low:.3f} to {high:.3f} mm, mostly by {budget.largest.cause.value}"
        '2.681 to 2.759 mm, mostly by touch'
    """

    reading_mm: float
    correction_mm: float
    parts: tuple[Part, ...]
    left_out: tuple[str, ...] = ()

    @property
    def corrected_mm(self) -> float:
        """The best estimate of the distance."""
        return self.reading_mm + self.correction_mm

    @property
    def sigma_mm(self) -> float:
        """Combined standard uncertainty: the root of the parts' squares (GUM 5.1.2)."""
        return math.hypot(*(part.sigma_mm for part in self.parts))

    @property
    def freedom(self) -> float:
        """Effective degrees of freedom (Welch-Satterthwaite, GUM G.4.1)."""
        spread = sum(part.sigma_mm**4 / part.freedom for part in self.parts)
        return self.sigma_mm**4 / spread if spread > 0 else math.inf

    @property
    def coverage_factor(self) -> float:
        """Student's factor of the 95 % interval (GUM G.3.2)."""
        from scipy.special import stdtrit

        return float(stdtrit(self.freedom, (1 + _LEVEL) / 2))

    @property
    def interval_mm(self) -> tuple[float, float]:
        """The 95 % interval of the distance, about the corrected one."""
        half = self.coverage_factor * self.sigma_mm
        return self.corrected_mm - half, self.corrected_mm + half

    @property
    def largest(self) -> Part | None:
        """The part that counts most; None if there is none."""
        # An unknown part may be the largest.
        unknown = (part for part in self.parts if math.isnan(part.sigma_mm))
        known = max(self.parts, key=lambda part: part.sigma_mm, default=None)
        return next(unknown, known)

    @classmethod
    def of(
        cls,
        reading_mm: float,
        *,
        correction_mm: float = 0.0,
        parts: Sequence[Part],
        left_out: tuple[str, ...] = (),
    ) -> Self:
        """The budget without the parts that are zero."""
        return cls(
            reading_mm=reading_mm,
            correction_mm=correction_mm,
            # NaN, an unknown part, stays.
            parts=tuple(part for part in parts if part.sigma_mm != 0),
            left_out=left_out,
        )
