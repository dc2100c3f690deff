"""The results as data: the error of every frame, and its size by speed."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Annotated, NamedTuple

from benchmarks.evaluation import ACCEPTABLE_ERROR_MM, LITERAL, SUBPIXEL, rms
from benchmarks.reporting import Column
from scenes import Scene

COMPARED = (LITERAL, SUBPIXEL)
"""The paper's way of measuring, at its fixed exposure, and ours."""

MOTIONS = {"withdrawal": "along the beam", "scan": "across the wall", "hand": "in a hand"}

LATENCIES_S = (0.0, 0.05, 0.1)
"""Delays with which a pose without a time stamp is read."""

PARTS = ("rest", "blur", "stamps", "latency")


class DynamicError(NamedTuple):
    """Row of dynamic_error.csv: one frame and latency; error = estimate - reading.

    `set_speed_mm_s` is the speed of a straight motion or the highest speed of a hand. `speed_mm_s`
    is the tip's speed in the middle of the exposure. `doubt` is the reason why an estimate does not
    count; `rest_doubt` is the same for the frame without blur. NaN: there is no estimate.
    """

    source: str
    motion: str
    way: str
    set_speed_mm_s: float
    run: int
    frame: int
    time_s: float
    exposure_s: float
    speed_mm_s: float
    d_mm: float
    latency_s: float
    doubt: str
    rest_doubt: str
    estimate_mm: float
    reading_mm: float
    error_mm: float
    rest_mm: float
    blur_mm: float
    stamps_mm: float
    latency_mm: float


class DynamicSpread(NamedTuple):
    """Row of dynamic_spread.csv: all frames of about one speed; `left_out`: without an estimate."""

    source: Annotated[str, Column("source")]
    motion: Annotated[str, Column("motion")]
    way: Annotated[str, Column("way")]
    speed_mm_s: Annotated[float, Column("mm/s", 1)]
    latency_s: float
    spots: Annotated[int, Column("spots")]
    left_out: Annotated[int, Column("left out")]
    rms_error_mm: Annotated[float, Column("error")]
    largest_error_mm: float
    rms_rest_mm: Annotated[float, Column("rest")]
    rms_blur_mm: Annotated[float, Column("blur")]
    rms_stamps_mm: Annotated[float, Column("stamps")]
    rms_latency_mm: Annotated[float, Column("latency")]
    mean_error_mm: float
    mean_rest_mm: float
    mean_blur_mm: float
    mean_stamps_mm: float
    mean_latency_mm: float


@dataclass(frozen=True, kw_only=True)
class DynamicFindings:
    """All results of a run.

    Attributes:
        scene: the study's.
        exposure_ms: at the mean distance.
        sources: kinds of light that were seen moving.
        speeds: mm/s.
        rows: every frame at every latency.
        spreads: by speed.
    """

    scene: Scene
    exposure_ms: float
    sources: tuple[str, ...]
    speeds: tuple[float, ...]
    rows: list[DynamicError]
    spreads: list[DynamicSpread]

    @property
    def stamped(self) -> list[DynamicError]:
        """Every frame, with stamped poses."""
        return [row for row in self.rows if row.latency_s == LATENCIES_S[0]]

    def by_speed(self, source: str, motion: str, way: str, latency_s: float) -> list[DynamicSpread]:
        """Rows that differ in the speed only, in its order."""
        rows = (row for row in self.spreads if row[:3] == (source, motion, way))
        return sorted(row for row in rows if row.latency_s == latency_s)

    def speed_limits(self, source: str, motion: str, way: str) -> list[float]:
        """Speed at which the RMS error is no longer acceptable, by latency, mm/s; NaN if none."""
        return [
            speed_at(self.by_speed(source, motion, way, latency), ACCEPTABLE_ERROR_MM)
            for latency in LATENCIES_S
        ]


def speed_at(rows: Iterable[DynamicSpread], limit_mm: float) -> float:
    """Speed at which the RMS error of rows that differ in the speed only reaches a limit, mm/s.

    Linear between the speeds, from the error at rest; NaN if the limit is not reached.
    """
    ordered = sorted(row for row in rows if not math.isnan(row.rms_error_mm))
    if not ordered:
        return math.nan
    at_rest = rms(row.rms_rest_mm for row in ordered)
    speeds = [0.0, *(row.speed_mm_s for row in ordered)]
    errors = [at_rest, *(row.rms_error_mm for row in ordered)]
    if at_rest >= limit_mm:
        return 0.0
    for n in range(1, len(speeds)):
        if errors[n] >= limit_mm:
            share = (limit_mm - errors[n - 1]) / (errors[n] - errors[n - 1])
            return speeds[n - 1] + share * (speeds[n] - speeds[n - 1])
    return math.nan
