"""What a fit found, whether it is good, and what remedies a bad one.

Judged by convergence, bounds, chi squared, the structure of residuals, and by what the rig file and
the images state of the same thing. A fit has one of four verdicts. It is good; or good with too
wide standard errors; or good with a stated misfit, whose effect its standard errors contain; or not
good. Only the last writes no calibration.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum, auto
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from eyespot.calibration.least_squares import accepted_range, slow_waves
from eyespot.calibration.pixels.fit_result import Failure
from eyespot.calibration.pixels.misfit import Misfit
from eyespot.calibration.recorded_trial import RecordedTrial
from eyespot.formats.calibration import QUANTITIES

_ROUNDING = 1e-9  # part of a standard error


class PixelResiduals(NamedTuple):
    """Residuals of a fit to pixels, averaged so that structure is visible, over their sigma."""

    maps: Float[np.ndarray, "groups h w"]
    """Averages over groups of frames and neighbouring pixels; NaN where nothing was fitted."""
    groups: list[tuple[int, int]]
    """First and last frame of each map."""
    frames: Int[np.ndarray, "n"]
    """Numbers of the frames with fitted pixels."""
    of_frames: Float[np.ndarray, "n"]
    """Mean over the pixels of each of these."""
    misfit: Misfit


@dataclass(frozen=True, kw_only=True, eq=False)
class Fitted:
    """The result of a fit, in the same form for every model."""

    calibration_model: str
    """Name in the calibration file."""
    values: dict[str, float]
    """The calibration file's parameters."""
    covariance: Float[np.ndarray, "p p"]
    """Of `values`, enlarged by the misfit."""
    converged: bool
    residuals: dict[str, Float[np.ndarray, "n"]]
    """By name, with variance 1: one per usable spot of `recordings` in order; empty for a fit to
    pixels. Ordered so that a misfit affects neighbours alike."""
    recordings: Sequence[RecordedTrial]
    used: int
    """Number of spots, or of frames, that the fit used."""
    degrees_of_freedom: int
    """Number of data and priors minus number of parameters."""
    stated: Mapping[str, Float[np.ndarray, "m p"]] = field(default_factory=dict)
    """As of `Calibration`."""
    shared: Mapping[str, Float[np.ndarray, "m p"]] = field(default_factory=dict)
    """By prior, how far `values` follow it, where other recordings of this lens have it, too."""
    microscope: str = ""
    """As of `Calibration`."""
    growth: float = 1.0
    """Factor on the data's variances by which a misfit of spots enlarged the covariance."""
    failed: Failure | None = None
    """The criterion of convergence that a fit to pixels does not meet."""
    chi_squared: float | None = None
    """None if the noise was estimated from the residuals."""
    bounds: tuple[str, ...] = ()
    """Bounds that the fit reached, in words."""
    undetermined: tuple[str, ...] = ()
    """Parameters that the data do not determine, in words."""
    others: list[tuple[str, float, float, str]] = field(default_factory=list)
    """Name, value, sigma and unit of fitted parameters that the file does not contain."""
    notes: list[str] = field(default_factory=list)
    """Sentences for the report."""
    disagreements: list[str] = field(default_factory=list)
    """What the fit and the rig file state differently, see `estimator.distance.consistency`."""
    lines: dict[str, tuple[np.ndarray, np.ndarray, np.ndarray]] = field(default_factory=dict)
    """By the recording's name: e1' of its spots, ascending, px; the model's distances and the
    half-widths of their 95 % confidence band, mm."""
    pixels: PixelResiduals | None = None
    """None for a fit to spots, and where it has `parts`."""
    parts: "Sequence[Fitted]" = ()
    """Fits to the pixels of one recording each, of which this is the mean; empty for one fit."""

    @property
    def rows(self) -> list[tuple[str, float, float, str]]:
        """Name, value, sigma and unit of all parameters, those of the file first."""
        sigma = np.sqrt(np.diag(self.covariance)).tolist()
        in_file = zip(self.values.items(), sigma, strict=True)
        every = [
            *((name, value, error, QUANTITIES[name].unit) for (name, value), error in in_file),
            *self.others,
        ]
        # What is left by rounding of an exact 0 would be printed with all of its digits.
        return [
            (name, 0.0 if abs(value) < _ROUNDING * min(error, 1.0) else value, error, unit)
            for name, value, error, unit in every
        ]

    @property
    def strong_correlations(self) -> str:
        """Pairs of fitted parameters with a correlation above 0.9, in words; empty if none."""
        names, sigma = list(self.values), np.sqrt(np.diag(self.covariance))
        with np.errstate(invalid="ignore", divide="ignore"):
            rho = self.covariance / np.outer(sigma, sigma)
        return ", ".join(
            f"{names[i]} and {names[j]} {rho[i, j]:+.2f}"
            for i, j in zip(*np.triu_indices(len(names), 1), strict=True)
            # False for NaN (a variance of 0 or infinity) and for 1 (one follows another).
            if 0.9 < abs(rho[i, j]) < 1 - 1e-9
        )

    @property
    def unit(self) -> str:
        """What `used` counts: spots or frames."""
        return "frames" if self.pixels or self.parts else "spots"

    @property
    def chi_squared_per_degree(self) -> float | None:
        """Expected to be 1 if noise and geometry are as assumed."""
        return None if self.chi_squared is None else self.chi_squared / self.degrees_of_freedom

    @property
    def inflation(self) -> float:
        """Largest factor by which a misfit enlarges a standard error; 1 without."""
        if self.parts:
            return max(part.inflation for part in self.parts)
        return self.pixels.misfit.inflation if self.pixels else math.sqrt(self.growth)


def bounds_hit(values: Mapping[str, float]) -> tuple[str, ...]:
    """Parameters outside their physical range, in words."""
    found = []
    for name, value in values.items():
        unit, low, high, low_included = QUANTITIES[name]
        if not low < value < high and not (low_included and value == low):
            found.append(f"{name} = {value:.6g} {unit}, outside of ({low:g}, {high:g})")
    return tuple(found)


MOST_CHI_SQUARED = 2.0
"""Largest chi squared per degree of freedom of a fit to spots. Below it, errors grow instead."""
MOST_MISFIT = 0.02
"""Largest misfit of a fit to pixels, as a part of the light. With more, a parameter's bias can be
several times its enlarged standard error (docs/fitting.md has departures of both kinds)."""
_NOTED_ENLARGEMENT = 1.2  # enlargement of the standard errors by a misfit that is worth a word
_KNOWN_VARIANCE = 0.1
"""Relative accuracy of a camera's data sheet. Residuals that are smaller by less say nothing."""
_SHARED_VARIANCE = 0.75
"""Part of spots' variances that may be of errors which all spots of a recording share, and which
residuals do not show: of drawn walls with 2 % texture it was up to 0.65."""
MOST_MOVED = 5.0
"""Standard errors by which structure of residuals may move the parameters. Below it, errors grow
instead; the wall's texture moves those of 60 spots by 3."""

_MAX_REASONS_IN_ERROR = 2  # reasons in an error message; the report lists all


class Fault(Enum):
    """The criterion that a fit does not meet; the first three are `Failure`'s."""

    STEPS = auto()
    FIRST_ROUND = auto()
    TABLES = auto()
    BOUND = auto()
    UNDETERMINED = auto()
    LARGE_RESIDUALS = auto()
    STRUCTURE = auto()
    MISFIT = auto()
    OVERSTATED_NOISE = auto()
    STATED_MISFIT = auto()
    DISAGREEMENT = auto()

    @property
    def harmless(self) -> bool:
        """Whether the values are right within their errors."""
        return self in (Fault.OVERSTATED_NOISE, Fault.STATED_MISFIT)


_PRIOR = "a prior (--prior NAME=MEAN,SIGMA)"
_FEWER = "fewer parameters (--free)"
_EVEN = "a wall that keeps still, with nothing in front of it"
_SPREAD = "spread in --free, if the wall spreads light"
_CONE = "--model cone, which fits the exact geometry"
_LENS = "--model lens, if the spot's edge is soft"
_PLACES = "withdrawals at other places, one within 1 mm of the axis and one beyond 3 mm"
_ROBOT = (
    "to check that robot.eye_from_robot is right to a degree, that the eye did not turn, and that "
    "--calibration belongs to this fibre; or leave out the withdrawal farthest from the axis"
)

_REMEDIES: dict[Fault, dict[str, str]] = {
    Fault.STEPS: {
        "plane sphere": f"--robust, which leaves out outliers, or {_CONE}",
        "cone image": f"{_FEWER}, or {_PRIOR} for those that are free",
        "eye": _PLACES,
        "lens": f"a lens to start from that is nearer to yours (--lens FILE), or {_FEWER}",
    },
    Fault.FIRST_ROUND: {
        "lens": "a lens to start from whose core, aperture and rim are yours (--lens FILE); or a "
        f"recording of {_EVEN}"
    },
    Fault.TABLES: {
        "lens": f"{_FEWER}, or a recording without the distances at which the spot is sharpest: "
        "there the lens's light is hardest to compute"
    },
    Fault.BOUND: {
        "plane sphere": f"{_CONE}, or recordings at other distances from the wall",
        "cone image": f"{_PRIOR} for the parameter at its bound, or a longer withdrawal",
        "eye": _PLACES,
        "lens": f"{_PRIOR} for the parameter at its bound, or fit without it (--free)",
    },
    Fault.UNDETERMINED: {
        "plane sphere": f"{_CONE}, and recordings at other places and distances",
        "cone image lens": f"{_PRIOR} for one of them, or fit without it (--free)",
        "eye": _PLACES,
    },
    Fault.LARGE_RESIDUALS: {
        "plane sphere": f"--robust, which leaves out outliers, or {_CONE}",
        "cone": f"{_LENS}; or the microscope's scale and the eye's radius, which may be wrong, in "
        "--free",
        "eye": _ROBOT,
    },
    Fault.STRUCTURE: {
        "plane sphere": f"{_CONE}, or --robust, which leaves out outliers",
        "cone": f"{_LENS}, or a recording of {_EVEN}",
        "eye": _ROBOT,
    },
    Fault.MISFIT: {
        "image": f"{_LENS}, {_SPREAD}, or a recording of {_EVEN}",
        "lens": f"{_SPREAD}, or a recording of {_EVEN}. A cap off centre, a tilted end and a "
        "Gaussian launch cannot be fitted",
    },
    Fault.DISAGREEMENT: {
        "cone image lens eye": "`eyespot rig check`, which compares the rig file with the recording"
    },
}
"""By fault and by models."""


def remedy(fault: Fault, *, model: str) -> str:
    """What to try, with options that the model has; empty if nothing is needed."""
    tries = _REMEDIES.get(fault, {}).items()
    return next((text for models, text in tries if model in models.split()), "")


class Doubt(NamedTuple):
    """A fault of a fit and the reason in words."""

    fault: Fault
    reason: str


def doubts(fitted: Fitted) -> list[Doubt]:
    """Reasons why a fit is not good; empty for a good fit."""
    if fitted.parts:
        named = [
            (part.recordings[0].name, doubt) for part in fitted.parts for doubt in doubts(part)
        ]
        return [Doubt(doubt.fault, f"{name}: {doubt.reason}") for name, doubt in named]
    # First, because they are the causes of others.
    found = [Doubt(Fault.DISAGREEMENT, f"disagree: {said}") for said in fitted.disagreements]
    if not fitted.converged:
        fault, reason = fitted.failed or ("STEPS", "")
        why = "the solver did not converge" + (f": {reason}" if reason else "")
        found.append(Doubt(Fault[fault], why))
    found += [Doubt(Fault.BOUND, f"it hit a bound: {bound}") for bound in fitted.bounds]
    found += [
        Doubt(Fault.UNDETERMINED, f"the data do not determine all parameters: {direction}")
        for direction in fitted.undetermined
    ]
    if fitted.chi_squared_per_degree is not None:
        misfit = fitted.pixels.misfit if fitted.pixels else None
        found += of_chi_squared(fitted.chi_squared_per_degree, fitted.degrees_of_freedom, misfit)
    return found + of_structure(fitted.residuals, noise_is_known=fitted.chi_squared is not None)


def of_structure(
    residuals: Mapping[str, Float[np.ndarray, "n"]], *, noise_is_known: bool
) -> list[Doubt]:
    """Doubts about slow waves in the residuals of spots: how far they may move the parameters."""
    structured = {
        name: math.sqrt(power)
        for name, power, _, found in slow_waves(residuals)
        if found and power > _NOTED_ENLARGEMENT**2
    }
    if not structured:
        return []
    names, moved = ", ".join(structured), max(structured.values())
    if noise_is_known and moved < MOST_MOVED:
        why = f"structure in the residuals of {names} may move the parameters by {moved:.2g} "
        why += "standard errors, which are enlarged as much"
        return [Doubt(Fault.STATED_MISFIT, why)]
    why = f"the residuals of {names} have structure, which may move the parameters by {moved:.2g} "
    why += "standard errors"
    return [Doubt(Fault.STRUCTURE, why)]


def of_chi_squared(value: float, degrees: int, misfit: Misfit | None) -> list[Doubt]:
    """Doubts about the size of the residuals, and for pixels about their structure."""
    low, high = accepted_range(degrees)
    said = f"chi squared per degree of freedom is {value:.3g}"
    of = f"({degrees} degrees of freedom)"
    if value < min(low, 1 - (_KNOWN_VARIANCE if misfit else _SHARED_VARIANCE)):
        why = f"{said}, below the {low:.3g} expected {of}: the noise is lower than assumed"
        return [Doubt(Fault.OVERSTATED_NOISE, why)]
    beyond = f"{said}, above the {high:.3g} expected from noise alone {of}"
    if misfit is None:
        if value <= high:
            return []
        if value > MOST_CHI_SQUARED:
            why = f"{beyond} and above the limit of {MOST_CHI_SQUARED:g}"
            return [Doubt(Fault.LARGE_RESIDUALS, f"{why}: the residuals are larger than the noise")]
        why = f"{beyond}, so the standard errors are enlarged {math.sqrt(value):.3g} times"
        return [Doubt(Fault.STATED_MISFIT, why)]
    why = f"the model misses the light by {100 * misfit.share:.2g} % (RMS; {said})"
    why += f"; {misfit.where}" if misfit.where else "; the residuals have no structure"
    if misfit.share > MOST_MISFIT:
        return [Doubt(Fault.MISFIT, f"{why}; the limit is {100 * MOST_MISFIT:g} %")]
    if not misfit.structured or misfit.inflation < _NOTED_ENLARGEMENT:
        return []
    why += f"; the standard errors are enlarged up to {misfit.inflation:.3g} times"
    return [Doubt(Fault.STATED_MISFIT, why)]


def verdict(found: Sequence[Doubt]) -> str:
    """The verdict on a fit whose calibration is written."""
    reasons = "; ".join(doubt.reason for doubt in found)
    if not found:
        return "A good fit"
    if any(doubt.fault is Fault.STATED_MISFIT for doubt in found):
        return f"Accepted, with enlarged standard errors: {reasons}"
    return f"Accepted, with too wide standard errors: {reasons}"


def refusal(found: Sequence[Doubt], *, model: str, report: Path | None = None) -> str:
    """The error message: what is wrong, what to try, and where the details are."""
    reasons = [doubt.reason for doubt in found]
    more = (
        f"; and {len(reasons) - _MAX_REASONS_IN_ERROR} more"
        if len(reasons) > _MAX_REASONS_IN_ERROR
        else ""
    )
    remedies = (remedy(doubt.fault, model=model) for doubt in found if not doubt.fault.harmless)
    shown = list(dict.fromkeys(filter(None, remedies)))[:_MAX_REASONS_IN_ERROR]
    if shown and _LENS in shown[0]:  # one remedy of two faults is named once
        shown[1:] = [text.removeprefix(f"{_LENS}, or ") for text in shown[1:]]
    tries = "; ".join(shown)
    said = f"not a good fit: {'; '.join(reasons[:_MAX_REASONS_IN_ERROR])}{more}."
    said += f"\nTry {tries}." if tries else ""
    details = f"\nNo calibration was written; {report} shows the residuals."
    return said if report is None else said + details
