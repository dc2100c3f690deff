"""What a moving tip adds to the error of a distance, part by part.

The estimate from a frame is held against the robot's reading, the distance along the beam at the
pose that is taken for the frame's. With the estimate d' from the blurred frame and d'_0 from the
same frame without blur, the true distance d in the middle of the exposure, the reading d_s of the
pose with that stamp, and d_l of one that is read late,

    d' - d_l = (d'_0 - d) + (d' - d'_0) + (d - d_s) + (d_s - d_l)
      error  =    rest    +    blur     +  stamps   +   latency

At constant withdrawal speed v a pose that is late by L gives the part latency = -v L: the robot has
gone on since the frame was taken.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import jax.numpy as jnp

import optics
from benchmarks.studies.dynamic.trials import nearest_speed
from estimator import PoseTrack

PARTS = ("rest", "blur", "stamps", "latency")


class DynamicError(NamedTuple):
    """Row of dynamic_error.csv: one frame and latency; error = estimate - reading.

    `set_speed_mm_s` is that of a straight motion and a hand's highest, `speed_mm_s` the tip's in
    the middle of the exposure; `doubt` says why an estimate does not count, `rest_doubt` the same
    of the frame without blur. NaN: there is none.
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

    source: str
    motion: str
    way: str
    speed_mm_s: float
    latency_s: float
    spots: int
    left_out: int
    rms_error_mm: float
    largest_error_mm: float
    rms_rest_mm: float
    rms_blur_mm: float
    rms_stamps_mm: float
    rms_latency_mm: float
    mean_error_mm: float
    mean_rest_mm: float
    mean_blur_mm: float
    mean_stamps_mm: float
    mean_latency_mm: float


class Parts(NamedTuple):
    """Error and its parts, mm; see the module."""

    error: float
    rest: float
    blur: float
    stamps: float
    latency: float


def parts(*, estimate: float, frozen: float, d: float, stamped: float, late: float) -> Parts:
    """Split an error; all in mm.

    Args:
        estimate: from the frame as it is.
        frozen: from the frame without blur.
        d: true, in the middle of the exposure.
        stamped: the robot's reading of the pose with that stamp.
        late: of the pose that is taken for the frame's.
    """
    return Parts(estimate - late, frozen - d, estimate - frozen, d - stamped, stamped - late)


def reading(poses: PoseTrack, time_s: float, wall: optics.Surface) -> float:
    """What the robot says the distance is, with the pose that was known at a time.

    Args:
        poses: as the robot stamped them.
        time_s: at which they are looked up.
        wall: of the eye, which the robot is given.

    Returns:
        From the tip along the beam to the wall, mm; NaN before the first pose.
    """
    found = poses.at(time_s)
    if found is None:
        return math.nan
    pose, _ = found
    meets = wall.intersect(jnp.array(pose.position_mm), jnp.array(pose.axis))
    return float(meets.distance)


def spreads(rows: Sequence[DynamicError], speeds: Sequence[float]) -> list[DynamicSpread]:
    """Size of errors and parts by the speed that is nearest to the tip's own."""
    groups: dict[tuple[str, str, str, float, float], list[DynamicError]] = {}
    for row in rows:
        speed = nearest_speed(row.speed_mm_s, speeds)
        key = row.source, row.motion, row.way, speed, row.latency_s
        groups.setdefault(key, []).append(row)
    return [_spread(key, group) for key, group in sorted(groups.items())]


def speed_at(rows: Iterable[DynamicSpread], limit_mm: float) -> float:
    """Speed at which the RMS error of rows that differ in it alone reaches a limit, mm/s.

    Linear between the speeds, from what is left at rest; NaN where it is not reached.
    """
    ordered = sorted(row for row in rows if not math.isnan(row.rms_error_mm))
    if not ordered:
        return math.nan
    at_rest = _rms([row.rms_rest_mm for row in ordered])
    speeds = [0.0, *(row.speed_mm_s for row in ordered)]
    errors = [at_rest, *(row.rms_error_mm for row in ordered)]
    if at_rest >= limit_mm:
        return 0.0
    for n in range(1, len(speeds)):
        if errors[n] >= limit_mm:
            share = (limit_mm - errors[n - 1]) / (errors[n] - errors[n - 1])
            return speeds[n - 1] + share * (speeds[n] - speeds[n - 1])
    return math.nan


def _spread(key: tuple[str, str, str, float, float], rows: list[DynamicError]) -> DynamicSpread:
    used = [row for row in rows if not row.doubt]
    columns = {
        name: [float(getattr(row, f"{name}_mm")) for row in used] for name in ("error", *PARTS)
    }
    sizes = {f"rms_{name}_mm": _rms(values) for name, values in columns.items()}
    sizes |= {f"mean_{name}_mm": _mean(values) for name, values in columns.items()}
    source, motion, way, speed, latency = key
    return DynamicSpread(
        source=source,
        motion=motion,
        way=way,
        speed_mm_s=speed,
        latency_s=latency,
        spots=len(used),
        left_out=len(rows) - len(used),
        largest_error_mm=max(map(abs, columns["error"]), default=math.nan),
        **sizes,
    )


def _rms(values: Sequence[float]) -> float:
    """Of those that are there."""
    return math.sqrt(_mean([value**2 for value in values]))


def _mean(values: Sequence[float]) -> float:
    there = [value for value in values if not math.isnan(value)]
    return sum(there) / len(there) if there else math.nan
