r"""What the printed figures of Table I imply for the distances behind them, by arithmetic.

R² and RMSE of a line give the spread of its readings, $\sigma_d^2 = \mathrm{RMSE}^2/(1 - R^2)$;
with slope and intercept they give every second moment of a trial but its mean distance. The line of
all trials together follows from these moments, the means and the numbers of spots, whatever the
lens. So the printed pooled row limits the distances at which the trials can have been.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import product
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares

from benchmarks.evaluation import PlaneRow

_FARTHEST_MM = 12.0
_WEIGHT_STEPS = 20


class Pooling(NamedTuple):
    """Trials at certain distances, and the line through all their spots.

    Attributes:
        means: mean reading of each trial, mm.
        weights: share of each trial in all spots.
    """

    means: tuple[float, ...]
    weights: tuple[float, ...]
    row: PlaneRow


def reading_spread(row: PlaneRow) -> float:
    """Standard deviation of the readings behind a line, mm."""
    return row.rmse / math.sqrt(1.0 - row.r_squared)


def even_span(row: PlaneRow) -> float:
    """Length of the range over which evenly spaced readings have that spread, mm."""
    return math.sqrt(12.0) * reading_spread(row)


def pooled(
    rows: Sequence[PlaneRow], *, means: Sequence[float], weights: Sequence[float]
) -> PlaneRow:
    """The line through all spots of trials.

    Args:
        rows: each trial's own line.
        means: mean reading of each, mm.
        weights: number of spots of each, up to a factor.
    """
    delta_k, b, r_squared, _ = np.array(rows).T
    spread = np.array([reading_spread(row) for row in rows]) ** 2
    # A line runs through the means, and its slope is the covariance over the variance of e1'.
    means_d, share = np.array(means), np.array(weights) / np.sum(weights)
    means_e = (means_d - b) / delta_k
    d, e = share @ means_d, share @ means_e
    variance_d = share @ (spread + (means_d - d) ** 2)
    variance_e = share @ (r_squared * spread / delta_k**2 + (means_e - e) ** 2)
    covariance = share @ (r_squared * spread / delta_k + (means_d - d) * (means_e - e))
    slope = covariance / variance_e
    explained = covariance * slope
    return PlaneRow(
        delta_k=float(slope),
        b=float(d - slope * e),
        r_squared=float(explained / variance_d),
        rmse=math.sqrt(max(0.0, variance_d - explained)),
    )


def from_contact(rows: Sequence[PlaneRow], *, weights: Sequence[float]) -> Pooling:
    """Trials of evenly spaced readings that begin at contact."""
    means = tuple(even_span(row) / 2 for row in rows)
    return Pooling(means, tuple(weights), pooled(rows, means=means, weights=weights))


def best_from_contact(rows: Sequence[PlaneRow], *, least_share: float) -> Pooling:
    """Of such trials, the numbers of spots whose pooled line is the straightest.

    Args:
        rows: each trial's own line.
        least_share: of each trial in all spots.
    """
    steps = np.linspace(least_share, 1.0, _WEIGHT_STEPS)
    choices = [w for w in product(steps, repeat=len(rows)) if max(w) == 1.0]
    fits = [from_contact(rows, weights=np.divide(w, np.sum(w)).tolist()) for w in choices]
    fits = [fit for fit in fits if min(fit.weights) >= least_share] or fits
    return max(fits, key=lambda fit: fit.row.r_squared)


def nearest(rows: Sequence[PlaneRow], printed: PlaneRow, *, tolerance: PlaneRow) -> Pooling:
    """Mean readings and numbers of spots whose pooled line is nearest to the printed one.

    Args:
        rows: each trial's own line.
        tolerance: unit of each figure's distance.
    """
    count = len(rows)

    def unpack(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        weights = np.exp(np.append(0.0, x[: count - 1]))
        return weights / weights.sum(), x[count - 1 :]

    def misfit(x: np.ndarray) -> np.ndarray:
        weights, means = unpack(x)
        row = pooled(rows, means=means.tolist(), weights=weights.tolist())
        return np.subtract(row, printed) / np.array(tolerance)

    bounds = np.array([(-3.0, 3.0)] * (count - 1) + [(0.0, _FARTHEST_MM)] * count).T
    starts = (np.append(np.zeros(count - 1), np.full(count, mean)) for mean in range(1, 11, 2))
    found = min((least_squares(misfit, x, bounds=bounds) for x in starts), key=lambda f: f.cost)
    weights, means = unpack(found.x)
    return Pooling(
        tuple(means.tolist()),
        tuple(weights.tolist()),
        pooled(rows, means=means.tolist(), weights=weights.tolist()),
    )
