"""What a moving tip adds to the error of a distance, part by part.

The estimate from a frame is compared with the robot's reading, the distance along the beam at the
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
from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp

import optics
from benchmarks.evaluation import largest, mean, rms
from benchmarks.studies.dynamic.findings import PARTS, DynamicError, DynamicSpread
from benchmarks.studies.dynamic.trials import nearest_speed
from estimator import PoseTrack


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
    """The distance by the robot, from the pose that was known at a time.

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


def _spread(key: tuple[str, str, str, float, float], rows: list[DynamicError]) -> DynamicSpread:
    used = [row for row in rows if not row.doubt]
    columns = {
        name: [float(getattr(row, f"{name}_mm")) for row in used] for name in ("error", *PARTS)
    }
    sizes = {f"rms_{name}_mm": rms(values) for name, values in columns.items()}
    sizes |= {f"mean_{name}_mm": mean(values) for name, values in columns.items()}
    source, motion, way, speed, latency = key
    return DynamicSpread(
        source=source,
        motion=motion,
        way=way,
        speed_mm_s=speed,
        latency_s=latency,
        spots=len(used),
        left_out=len(rows) - len(used),
        largest_error_mm=largest(columns["error"]),
        **sizes,
    )
