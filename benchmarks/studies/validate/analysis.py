"""The range that reproduces Table I best; distances at which a lens's radius is ambiguous."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from benchmarks.evaluation import ALL_PLANES, SUBPIXEL, Criterion, PlaneRow, Way, reproduction
from benchmarks.reporting import Claim
from benchmarks.studies.validate.findings import ValidateFindings
from calibration import fit_lines

_STEP_MM = 0.5
_SHORTEST_MM = 2.0


class PartialFit(NamedTuple):
    """The criteria of Table I on the spots of a part of the range, low <= d_r <= high (mm)."""

    low: float
    high: float
    criteria: dict[Criterion, Claim]

    @property
    def met(self) -> int:
        """Number of criteria that are met."""
        return sum(bool(claim.holds) for claim in self.criteria.values())


def nearest_reproduction(findings: ValidateFindings, *, source: str, way: Way) -> PartialFit | None:
    """The widest of those parts of the range that meet most criteria of Table I.

    The paper does not state the distances of its fits. This tries all parts of 2 mm or more that
    begin and end at multiples of 0.5 mm. None if no part has three spots of each trial.
    """
    tracked = {t.group: findings.tracked[t.name, way.name] for t in findings.planes(source)}
    farthest = max(t.travel_mm.max(initial=0.0) for t in tracked.values())
    ends = np.arange(0.0, farthest + 1e-6, _STEP_MM)
    parts = []
    for low in ends:
        for high in ends[ends >= low + _SHORTEST_MM]:
            spots = {}
            for group, t in tracked.items():
                inside = (t.travel_mm > low - 1e-6) & (t.travel_mm < high + 1e-6)
                spots[group] = t.semi_minor_px[inside], t.travel_mm[inside]
            if all(e.size >= 3 for e, _ in spots.values()):
                axes, travels = zip(*spots.values(), strict=True)
                spots[ALL_PLANES] = np.concatenate(axes), np.concatenate(travels)
                fits = {
                    group: PlaneRow(*(float(value) for value in fit_lines(e, d)))
                    for group, (e, d) in spots.items()
                }
                parts.append(PartialFit(float(low), float(high), reproduction(fits)))
    return max(parts, key=lambda part: (part.met, part.high - part.low), default=None)


def half_maximum_curve(findings: ValidateFindings) -> tuple[np.ndarray, np.ndarray] | None:
    """Distance and half-maximum radius (mm) of the lens on the first plane; None without a lens."""
    if not findings.planes("lens"):
        return None
    trial = findings.planes("lens")[0]
    labels = findings.tracked[trial.name, SUBPIXEL.name].labels
    radius_px = np.array([row.half_max_semi_minor_px for row in labels])
    d = np.array([row.d_mm for row in labels])
    return d, radius_px * trial.scene.microscope.scale_mm_px


def ambiguous_range(distance: np.ndarray, radius: np.ndarray) -> tuple[float, float] | None:
    """First and last distance that share their radius with another distance, or None."""
    largest_before = np.maximum.accumulate(np.concatenate([[-math.inf], radius[:-1]]))
    least_after = np.minimum.accumulate(np.concatenate([radius[1:], [math.inf]])[::-1])[::-1]
    shared = (radius <= largest_before) | (radius >= least_after)
    if not shared.any():
        return None
    return float(distance[shared].min()), float(distance[shared].max())
