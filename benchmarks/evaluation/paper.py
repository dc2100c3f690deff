"""What Zhou et al. 2020 report, as printed, and whether fits reproduce their Table I."""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum
from typing import NamedTuple

from benchmarks.reporting import Claim
from calibration import PlaneFit


class PlaneRow(NamedTuple):
    """Row of Table I; mm."""

    delta_k: float
    b: float
    r_squared: float
    rmse: float


class SphereRow(NamedTuple):
    """Row of Table II; mm."""

    c: float
    standard_deviation: float
    mean_absolute_error: float
    max_error: float


ALL_PLANES = "all planes"
"""The row of Table I for all its trials together."""

TABLE_I = {
    "plane 1": PlaneRow(0.1496, -6.791, 0.9959, 0.0548),
    "plane 2": PlaneRow(0.1343, -5.069, 0.9909, 0.0974),
    "plane 3": PlaneRow(0.1347, -5.226, 0.9961, 0.0663),
    ALL_PLANES: PlaneRow(0.1321, -5.117, 0.9703, 0.1630),
}

TABLE_II = {
    "sphere 1": SphereRow(5.531, 0.064, 0.146, 0.328),
    "sphere 2": SphereRow(6.982, 0.097, 0.140, 0.372),
    "sphere 3": SphereRow(4.584, 0.088, 0.160, 0.396),
}

ACCEPTABLE_ERROR_MM = 0.5
"""The error that the paper calls acceptable."""

PAPERS_PLANES = {name: row for name, row in TABLE_I.items() if name != ALL_PLANES}
"""The rows of Table I for single trials."""


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
