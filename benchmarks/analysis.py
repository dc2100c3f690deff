"""Questions of yes or no that the report answers, as functions of the findings."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from benchmarks.model_error import ModelError
from benchmarks.paper import TABLE_I
from benchmarks.tables import ALL_PLANES
from benchmarks.validate import SUBPIXEL, Findings
from calibration import PlaneFit


class Criterion(NamedTuple):
    """One demand of "reproduces Table I": every value must lie in [low, high].

    Attributes:
        quantity: in words and symbols.
        unit: with a leading space, or empty.
        digits: worth printing.
        low: mm, mm/px or 1.
        high: likewise.
        values: what was found, likewise.
    """

    quantity: str
    unit: str
    digits: int
    low: float
    high: float
    values: tuple[float, ...]

    @property
    def met(self) -> bool:
        """Whether the demand is met."""
        return all(self.low <= value <= self.high for value in self.values)


def reproduction(fits: dict[str, PlaneFit]) -> list[Criterion]:
    """What "reproduces Table I" asks of one source measured in one way.

    The fit of all planes must be that of the paper, give or take what tells its own trials apart,
    and each trial must be as straight as the paper's.
    """
    trials = [fit for name, fit in fits.items() if name != ALL_PLANES]
    pooled, printed = fits[ALL_PLANES], TABLE_I[ALL_PLANES]
    delta_k, b = round(printed.delta_k, 3), round(printed.b, 1)
    return [
        Criterion("δk", " mm/px", 4, delta_k - 0.006, delta_k + 0.006, (pooled.delta_k,)),
        Criterion("b", " mm", 2, b - 0.5, b + 0.5, (pooled.b,)),
        Criterion("R² of each trial", "", 4, 0.99, 1.0, tuple(f.r_squared for f in trials)),
        Criterion("RMSE of each trial", " mm", 3, 0.05, 0.10, tuple(f.rmse for f in trials)),
    ]


def half_maximum_curve(findings: Findings) -> tuple[np.ndarray, np.ndarray] | None:
    """Distance and half-maximum radius (mm) of the lens on the first plane; None without a lens."""
    trial = next((t for t in findings.trials if (t.source, t.kind) == ("lens", "plane")), None)
    if trial is None:
        return None
    labels = findings.tracked[trial.name, SUBPIXEL].labels
    scale = trial.scene.microscope.scale_mm_px
    d = np.array([row.d_mm for row in labels])
    return d, np.array([row.half_max_semi_minor_px for row in labels]) * scale


def ambiguous_range(distance: np.ndarray, radius: np.ndarray) -> tuple[float, float] | None:
    """First and last distance whose radius another distance has too; None where there is none."""
    largest_before = np.maximum.accumulate(np.concatenate([[-math.inf], radius[:-1]]))
    least_after = np.minimum.accumulate(np.concatenate([radius[1:], [math.inf]])[::-1])[::-1]
    shared = (radius <= largest_before) | (radius >= least_after)
    if not shared.any():
        return None
    return float(distance[shared].min()), float(distance[shared].max())


def limit_eccentricity(errors: Iterable[ModelError], limit: float) -> float | None:
    """Smallest c at which the largest error over all distances reaches the limit, mm.

    Linear between the eccentricities computed; None where the limit is never reached.
    """
    worst: dict[float, float] = {}
    for error in errors:
        worst[error.c_mm] = max(worst.get(error.c_mm, 0.0), abs(error.error_mm))
    before: tuple[float, float] | None = None
    for c, size in sorted(worst.items()):
        if size >= limit:
            if before is None:
                return c
            return before[0] + (c - before[0]) * (limit - before[1]) / (size - before[1])
        before = c, size
    return None
