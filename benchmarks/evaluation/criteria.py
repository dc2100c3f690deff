"""Whether fits reproduce Table I of the paper: four criteria, each a claim with its bounds."""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum

from benchmarks.evaluation.paper import ALL_PLANES, PAPERS_PLANES, TABLE_I, PlaneRow
from benchmarks.reporting import Claim
from calibration import PlaneFit


class Criterion(StrEnum):
    """A quantity of Table I."""

    DELTA_K = "δk"
    B = "b"
    R_SQUARED = "R² of each trial"
    RMSE = "RMSE of each trial"


STRAIGHT = 0.99
"""R² of a straight line; each trial of Table I has more."""


def reproduction(
    fits: Mapping[str, PlaneFit | PlaneRow], *, name: str = "Table I"
) -> dict[Criterion, Claim]:
    """The criteria for fits of one source measured in one way.

    The fit of all planes must be the paper's, within the differences between its own trials; each
    trial must be as straight as the paper's.

    Args:
        fits: by the rows of Table I.
        name: of the claims, before the criterion.
    """
    trials = [fits[trial] for trial in PAPERS_PLANES if trial in fits]
    r_squared, rmse = tuple(f.r_squared for f in trials), tuple(f.rmse for f in trials)
    pooled, printed = fits[ALL_PLANES], TABLE_I[ALL_PLANES]
    slope, b = round(printed.delta_k, 3), round(printed.b, 1)
    bounds = {
        Criterion.DELTA_K: ((pooled.delta_k,), slope - 0.006, slope + 0.006, "{value:.4f} mm/px"),
        Criterion.B: ((pooled.b,), b - 0.5, b + 0.5, "{value:.2f} mm"),
        Criterion.R_SQUARED: (r_squared, STRAIGHT, 1.0, "{value:.3f}"),
        Criterion.RMSE: (rmse, 0.05, 0.10, "{value:.3f} mm"),
    }
    return {
        criterion: Claim(
            name=f"{name}, {criterion}",
            sentence=f"{shown} (Table I demands {{low:g}} to {{high:g}}).",
            value=values,
            low=low,
            high=high,
        )
        for criterion, (values, low, high, shown) in bounds.items()
    }
