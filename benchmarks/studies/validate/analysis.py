"""Questions of yes or no that the report answers, as functions of the findings."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import NamedTuple

import numpy as np

from benchmarks.evaluation import TABLE_I, ModelError, PlaneRow
from benchmarks.studies.validate.run import SUBPIXEL, Findings
from benchmarks.studies.validate.tables import ALL_PLANES
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


class PartialFit(NamedTuple):
    """The demands on the spots of a part of the range, low <= d_r <= high (mm)."""

    low: float
    high: float
    criteria: list[Criterion]


STRAIGHT = 0.99
"""R² of a straight line; each trial of Table I is above."""
_STEP_MM = 0.5
_SHORTEST_MM = 2.0


def reproduction(fits: Mapping[str, PlaneFit | PlaneRow]) -> list[Criterion]:
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
        Criterion("R² of each trial", "", 3, STRAIGHT, 1.0, tuple(f.r_squared for f in trials)),
        Criterion("RMSE of each trial", " mm", 3, 0.05, 0.10, tuple(f.rmse for f in trials)),
    ]


def nearest_reproduction(findings: Findings, *, source: str, way: str) -> PartialFit | None:
    """The part of the range that meets most of what Table I asks, the widest of those.

    The paper does not say over which distances it fitted. Tried are all parts of 2 mm or more that
    begin and end at multiples of 0.5 mm; None where no trial has three spots in any of them.
    """
    spots = {
        trial.group: findings.tracked[trial.name, way]
        for trial in findings.trials
        if (trial.source, trial.kind) == (source, "plane")
    }
    ends = np.arange(
        0.0, max(t.travel_mm.max(initial=0.0) for t in spots.values()) + 1e-6, _STEP_MM
    )
    parts = []
    for low in ends:
        for high in ends[ends >= low + _SHORTEST_MM]:
            readings: dict[str, tuple[np.ndarray, np.ndarray]] = {}
            for group, tracked in spots.items():
                inside = (tracked.travel_mm > low - 1e-6) & (tracked.travel_mm < high + 1e-6)
                readings[group] = tracked.semi_minor_px[inside], tracked.travel_mm[inside]
            if all(e.size >= 3 for e, _ in readings.values()):
                axes, travels = zip(*readings.values(), strict=True)
                readings[ALL_PLANES] = np.concatenate(axes), np.concatenate(travels)
                fits = {group: _line(e, d) for group, (e, d) in readings.items()}
                parts.append(PartialFit(float(low), float(high), reproduction(fits)))
    return max(
        parts,
        key=lambda part: (sum(c.met for c in part.criteria), part.high - part.low),
        default=None,
    )


def _line(semi_minor_px: np.ndarray, distance: np.ndarray) -> PlaneRow:
    """What `calibration.fit_plane` finds, without standard errors and a thousand times faster."""
    delta_k, b = np.polyfit(semi_minor_px, distance, 1)
    squares = np.square(delta_k * semi_minor_px + b - distance)
    return PlaneRow(
        float(delta_k),
        float(b),
        float(1 - squares.sum() / np.square(distance - distance.mean()).sum()),
        float(np.sqrt(squares.mean())),
    )


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
