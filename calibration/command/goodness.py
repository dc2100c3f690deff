"""Whether a fit may be called good: convergence, bounds, chi squared, runs of residuals."""

from __future__ import annotations

import math
from collections.abc import Mapping
from fractions import Fraction
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from estimator.files import QUANTITIES

CHI_SQUARED = (0.8, 1.25)
"""Per degree of freedom: outside, the noise model or the geometry is not that of the data."""
SIGNIFICANCE = 0.01
"""Chance of calling good residuals structured, over all of a fit's runs tests together."""


class Doubt(NamedTuple):
    """Why a fit is not called good.

    Attributes:
        reason: in words.
        harmless: the values stand, and their errors are larger than they need be.
    """

    reason: str
    harmless: bool = False


def doubts(
    *,
    converged: bool,
    bounds: tuple[str, ...],
    undetermined: tuple[str, ...],
    chi_squared_per_degree: float | None,
    residuals: Mapping[str, Float[np.ndarray, "n"]],
) -> list[Doubt]:
    """Why a fit is not good; empty if it is.

    Args:
        converged: whether the solver says so.
        bounds: bounds that the fit ran into, in words.
        undetermined: directions that the data do not hold, in words.
        chi_squared_per_degree: None where the noise was estimated from the residuals themselves.
        residuals: by name, in the order in which neighbours would share a misfit.
    """
    found = [] if converged else [Doubt("the solver did not converge")]
    found += [Doubt(f"it hit a bound: {bound}") for bound in bounds]
    found += [Doubt(f"the data do not determine {direction}") for direction in undetermined]
    low, high = CHI_SQUARED
    if chi_squared_per_degree is not None and not low <= chi_squared_per_degree <= high:
        wide = chi_squared_per_degree < low
        told = f"chi squared per degree of freedom is {chi_squared_per_degree:.2f}, not within "
        why = (
            "more noise was reckoned with than there is, so that the errors are too large"
            if wide
            else "the model leaves more than the noise that was reckoned with"
        )
        found.append(Doubt(f"{told}{low} and {high}: {why}", harmless=wide))
    level = SIGNIFICANCE / max(len(residuals), 1)
    for name, values in residuals.items():
        chance = runs_probability(values)
        if chance < level:
            found.append(
                Doubt(
                    f"the residuals of {name} have structure: so few changes of sign have a chance "
                    f"of {chance:.1g} (Wald-Wolfowitz, one-sided, level {level:.2g})"
                )
            )
    return found


def runs_probability(values: Float[np.ndarray, "n"]) -> float:
    """Chance that values of random order change their sign as seldom as these, or more so.

    The exact distribution of the number of runs, given how many are positive and how many not
    (Wald and Wolfowitz 1940).
    """
    signs = np.sign(values[values != 0])
    positive, negative = int(np.sum(signs > 0)), int(np.sum(signs < 0))
    if positive == 0 or negative == 0:
        # All of one sign, as residuals with a mean of zero never are: conditioning hides it.
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
    """Parameters outside of what they can be, in words."""
    told = []
    for name, value in values.items():
        unit, low, high, _ = QUANTITIES[name]
        if not low < value < high:
            told.append(f"{name} = {value:.6g} {unit}, outside of ({low:g}, {high:g})")
    return tuple(told)
