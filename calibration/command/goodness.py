"""Checks of a fit: convergence, bounds, chi squared, structure of residuals.

A fit has one of four verdicts. It is good; or good with too wide standard errors; or good with a
stated misfit, whose effect its standard errors contain; or not good. Only the last writes no
calibration.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from fractions import Fraction
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from calibration.command.remedies import OF_CRITERION, Fault, remedy
from calibration.pixels import Failure, Misfit
from calibration.solvers import accepted_range
from estimator.files import QUANTITIES

MOST_CHI_SQUARED = 2.0
"""Largest chi squared per degree of freedom of a fit to spots. Below it, errors grow instead."""
MOST_MISFIT = 0.02
"""Largest misfit of a fit to pixels, as a part of the light. With more, a parameter's bias can be
several times its enlarged standard error (docs/fitting.md has departures of both kinds)."""
_KNOWN_VARIANCE = 0.1
"""Relative accuracy of a camera's data sheet. Residuals that are smaller by less say nothing."""
SIGNIFICANCE = 0.01
"""Probability that random residuals fail at least one of a fit's runs tests."""

_SHOWN = 2  # reasons in an error message; the report lists all


class Doubt(NamedTuple):
    """A fault of a fit and the reason in words."""

    fault: Fault
    reason: str

    @property
    def harmless(self) -> bool:
        """Whether the values are right within their errors."""
        return self.fault.harmless


def doubts(
    *,
    converged: bool,
    failed: Failure | None = None,
    bounds: tuple[str, ...],
    undetermined: tuple[str, ...],
    chi_squared_per_degree: float | None,
    degrees_of_freedom: int,
    misfit: Misfit | None,
    residuals: Mapping[str, Float[np.ndarray, "n"]],
) -> list[Doubt]:
    """Reasons why a fit is not good; empty for a good fit.

    Args:
        converged: whether the solver converged.
        failed: the criterion of convergence that a fit to pixels does not meet; None if it does.
        bounds: bounds that the fit reached, in words.
        undetermined: parameters that the data do not determine, in words.
        chi_squared_per_degree: None if the noise was estimated from the residuals themselves.
        degrees_of_freedom: those of chi squared.
        misfit: of a fit to pixels; None for a fit to spots.
        residuals: of a fit to spots, by name, ordered so that a misfit affects neighbours alike.
    """
    found: list[Doubt] = []
    if not converged:
        why = "the solver did not converge" + (f": {failed.reason}" if failed else "")
        found.append(Doubt(OF_CRITERION[failed.criterion] if failed else Fault.STEPS, why))
    found += [Doubt(Fault.BOUND, f"it hit a bound: {bound}") for bound in bounds]
    found += [
        Doubt(Fault.UNDETERMINED, f"the data do not determine all parameters: {direction}")
        for direction in undetermined
    ]
    if chi_squared_per_degree is not None:
        found += _of_chi_squared(chi_squared_per_degree, degrees_of_freedom, misfit)
    level = SIGNIFICANCE / max(len(residuals), 1)
    chances = {name: runs_probability(values) for name, values in residuals.items()}
    structured = [name for name, chance in chances.items() if chance < level]
    if structured:
        why = (
            f"the residuals of {', '.join(structured)} have structure (runs test: probability "
            f"{min(chances.values()):.1g}, level {level:.2g})"
        )
        found.append(Doubt(Fault.STRUCTURE, why))
    return found


def _of_chi_squared(value: float, degrees: int, misfit: Misfit | None) -> list[Doubt]:
    """Doubts about the size of the residuals, and for pixels about their structure."""
    low, high = accepted_range(degrees)
    said = f"chi squared per degree of freedom is {value:.3g}"
    if value < min(low, 1 - _KNOWN_VARIANCE):
        why = f"{said}, below the {low:.3g} of {degrees} degrees: the noise is lower than assumed"
        return [Doubt(Fault.OVERSTATED_NOISE, why)]
    beyond = f"{said}, above the {high:.3g} that noise explains with {degrees} degrees"
    if misfit is None:
        if value <= high:
            return []
        if value > MOST_CHI_SQUARED:
            why = f"{beyond} and above the limit of {MOST_CHI_SQUARED:g}"
            return [Doubt(Fault.LARGE_RESIDUALS, f"{why}: the residuals are larger than the noise")]
        why = f"{beyond}, so the standard errors are enlarged {math.sqrt(value):.3g} times"
        return [Doubt(Fault.STATED_MISFIT, why)]
    if not misfit.structured and value <= max(high, 1 + _KNOWN_VARIANCE):
        return []
    why = f"the model misses the light by {100 * misfit.share:.2g} % (RMS; {said})"
    why += f"; {misfit.where}" if misfit.where else "; the residuals have no structure"
    if misfit.share > MOST_MISFIT:
        return [Doubt(Fault.MISFIT, f"{why}; the limit is {100 * MOST_MISFIT:g} %")]
    why += f"; the standard errors are enlarged up to {misfit.inflation:.3g} times"
    return [Doubt(Fault.STATED_MISFIT, why)]


def verdict(found: Sequence[Doubt]) -> str:
    """The verdict on a fit whose calibration is written."""
    reasons = "; ".join(doubt.reason for doubt in found)
    if not found:
        return "A good fit"
    if any(doubt.fault is Fault.STATED_MISFIT for doubt in found):
        return f"A good fit with a stated misfit: {reasons}"
    return f"A good fit with too wide standard errors: {reasons}"


def refusal(found: Sequence[Doubt], *, model: str, report: Path) -> str:
    """The error message, in three lines: what is wrong, what to try, where the details are."""
    reasons = [doubt.reason for doubt in found]
    more = f"; and {len(reasons) - _SHOWN} more" if len(reasons) > _SHOWN else ""
    remedies = (remedy(doubt.fault, model=model) for doubt in found if not doubt.harmless)
    tries = "; ".join(list(dict.fromkeys(filter(None, remedies)))[:_SHOWN])
    return (
        f"not a good fit: {'; '.join(reasons[:_SHOWN])}{more}.\n"
        f"Try {tries}.\n"
        f"No calibration was written; {report} shows the residuals."
    )


def runs_probability(values: Float[np.ndarray, "n"]) -> float:
    """Probability that randomly ordered values form as few runs of one sign as these, or fewer.

    Exact distribution of the number of runs for the given numbers of positive and negative values
    (Wald and Wolfowitz 1940).
    """
    signs = np.sign(values[values != 0])
    positive, negative = int(np.sum(signs > 0)), int(np.sum(signs < 0))
    if positive == 0 or negative == 0:
        # The conditional test always passes here, so use the probability that all signs agree.
        return math.ldexp(2.0, -len(signs)) if len(signs) else 1.0
    runs = 1 + int(np.sum(signs[1:] != signs[:-1]))
    ways = 0
    for number in range(2, runs + 1):
        half, odd = divmod(number, 2)
        if odd:
            ways += math.comb(positive - 1, half) * math.comb(negative - 1, half - 1)
            ways += math.comb(positive - 1, half - 1) * math.comb(negative - 1, half)
        else:
            ways += 2 * math.comb(positive - 1, half - 1) * math.comb(negative - 1, half - 1)
    return float(Fraction(ways, math.comb(positive + negative, positive)))


def bounds_hit(values: Mapping[str, float]) -> tuple[str, ...]:
    """Parameters outside their physical range, in words."""
    found = []
    for name, value in values.items():
        unit, low, high, _ = QUANTITIES[name]
        if not low < value < high:
            found.append(f"{name} = {value:.6g} {unit}, outside of ({low:g}, {high:g})")
    return tuple(found)
