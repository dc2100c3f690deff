"""What a run of `eyespot track` came to: counts by reason, for a person and for a program."""

from __future__ import annotations

import math
from statistics import median
from typing import Any

from rich.table import Table

from estimator.run.offline import Tracking
from estimator.sources import Source


def summary_of(tracking: Tracking, source: Source, mode: str, seconds: float) -> dict[str, Any]:
    """What `eyespot track --json` prints, but for the names of the files written."""
    records = tracking.records
    ages = [record.pose_age_s for record in records if not math.isnan(record.pose_age_s)]
    return {
        "source": source.name,
        "mode": mode,
        "frames": len(records),
        "spots": tracking.spots,
        "no_spot": dict(tracking.no_spot.most_common()),
        "distances": sum(not math.isnan(record.distance_mm) for record in records),
        "doubtful_distances": tracking.doubtful,
        "median_pose_age_s": median(ages) if ages else None,
        "seconds": round(seconds, 3),
        "ended": tracking.ended.value,
        "fault": tracking.fault,
    }


def table_of(summary: dict[str, Any]) -> Table:
    """The same for a person."""
    table = Table()
    table.add_column(summary["mode"])
    table.add_column("frames", justify="right")
    table.add_row("spot", str(summary["spots"]))
    for reason, count in summary["no_spot"].items():
        table.add_row(f"no spot: {reason.replace('_', ' ')}", str(count))
    table.add_section()
    table.add_row("all", str(summary["frames"]))
    if summary["distances"]:
        table.add_row("with a distance", str(summary["distances"]))
    for flag, count in summary["doubtful_distances"].items():
        table.add_row(f"distance {flag.replace('_', ' ')}", str(count))
    if summary["median_pose_age_s"] is not None:
        table.caption = f"median age of the pose: {1e3 * summary['median_pose_age_s']:.1f} ms"
    return table
