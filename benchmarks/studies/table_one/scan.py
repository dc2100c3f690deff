"""The scan: the threshold and range at which each lens comes nearest to Table I."""

from __future__ import annotations

import math

import numpy as np

from benchmarks.evaluation import ALL_PLANES, TABLE_I, Criterion, reproduction
from benchmarks.studies.table_one.findings import Demand, LensChoice
from benchmarks.studies.table_one.isophotes import FARTHEST_MM, Isophotes
from calibration import Lines, fit_lines
from estimator import LiteralSettings

LEVELS = np.geomspace(0.1, 2.0, 31)
"""Thresholds, relative to the peak irradiance at `exposures.paper_distance_mm`."""
SCALES_MM_PX = (0.005, 0.016)
"""Those of a view of 10 mm on 2000 and on 640 pixels; the paper does not give its scale."""
NEAR_CONTACT_MM = 0.5
"""First reading of a range from contact: nearer, the shaft hides a part of the spot."""
_STEP_MM = 0.1
_STARTS_MM = np.arange(0.0, 5.1, 0.5)
_SPANS_MM = (3.0, 3.5, 4.0, 5.0, 6.0)


def readings(low: float, high: float) -> np.ndarray:
    """Evenly spaced readings d_r, mm."""
    return np.linspace(low, high, round((high - low) / _STEP_MM) + 1)


def misses(lines: Lines, *, scale: float | np.ndarray) -> np.ndarray:
    """Worst violation of `reproduction` by lines with slopes in mm/mm, in units of its tolerance.

    A line without noise may be straighter than the paper's.
    """
    asked = reproduction(TABLE_I)
    delta_k, b = asked[Criterion.DELTA_K], asked[Criterion.B]
    parts = [
        np.abs(lines.delta_k * scale - 0.5 * (delta_k.low + delta_k.high))
        / (0.5 * (delta_k.high - delta_k.low)),
        np.abs(lines.b - 0.5 * (b.low + b.high)) / (0.5 * (b.high - b.low)),
        (1.0 - lines.r_squared) / (1.0 - asked[Criterion.R_SQUARED].low),
        lines.rmse / asked[Criterion.RMSE].high,
    ]
    return np.nan_to_num(np.max(parts, axis=0), nan=np.inf)


def best_choices(isophotes: Isophotes, *, scale: float) -> list[LensChoice]:
    """The threshold and range at which a lens comes nearest to Table I, by each way of asking.

    Args:
        isophotes: of the lens.
        scale: delta, mm/px.
    """
    every = readings(0.0, FARTHEST_MM)
    radius = isophotes.radius(every[None, :], level=LEVELS[:, None])
    radius = np.where(_seen(radius / scale), radius, np.nan)
    ranges = [(a, a + span) for a in _STARTS_MM for span in _SPANS_MM if a + span <= FARTHEST_MM]
    found: dict[Demand, LensChoice] = {}
    for low, high in ranges:
        inside = (every >= low - 1e-6) & (every <= high + 1e-6)
        lines = fit_lines(radius[:, inside], every[inside])
        whole = np.isfinite(radius[:, inside]).all(axis=1)
        lines = Lines(*(np.where(whole, value, np.nan) for value in lines))
        with np.errstate(divide="ignore"):
            own = np.clip(TABLE_I[ALL_PLANES].delta_k / lines.delta_k, *SCALES_MM_PX)
        asked = {Demand.ANYWHERE: own}
        if low <= NEAR_CONTACT_MM:
            asked[Demand.AT_SCALE] = np.full(LEVELS.size, scale)
        for way, scales in asked.items():
            miss = misses(lines, scale=scales)
            n = int(np.argmin(miss))
            if way not in found or miss[n] < found[way].miss:
                found[way] = LensChoice(
                    *isophotes.family,
                    asked=way,
                    level=float(LEVELS[n]),
                    from_mm=float(low),
                    to_mm=float(high),
                    scale_mm_px=float(scales[n]),
                    delta_k_mm_px=float(lines.delta_k[n] * scales[n]),
                    b_mm=float(lines.b[n]),
                    r_squared=float(lines.r_squared[n]),
                    rmse_mm=float(lines.rmse[n]),
                    miss=float(miss[n]),
                )
    return [found[way] for way in Demand]


def _seen(semi_minor_px: np.ndarray) -> np.ndarray:
    """Whether the literal tracker accepts a spot of that size."""
    settings = LiteralSettings()
    large = math.pi * semi_minor_px**2 > settings.min_component_px
    return large & (2 * semi_minor_px < settings.max_minor_axis_px)
