"""Chi squared against its degrees of freedom: the range that noise alone explains."""

from __future__ import annotations

from scipy import stats

CHANCE = 1e-3
"""Probability that noise alone puts chi squared outside of the accepted range, on each side."""


def accepted_range(degrees_of_freedom: float) -> tuple[float, float]:
    """Range of chi squared per degree of freedom that noise alone explains."""
    low, high = stats.chi2.ppf((CHANCE, 1 - CHANCE), degrees_of_freedom)
    return float(low / degrees_of_freedom), float(high / degrees_of_freedom)


def excess_variance(chi_squared_per_degree: float, degrees_of_freedom: float) -> float:
    """Factor by which variances must grow if residuals without structure exceed their noise.

    It is chi squared per degree of freedom (Birge 1932) if noise alone does not explain it, and 1
    otherwise.
    """
    _, high = accepted_range(degrees_of_freedom)
    return chi_squared_per_degree if chi_squared_per_degree > high else 1.0
