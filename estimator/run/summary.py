"""Summary of a run of `eyespot track`: counts by reason, as a table or as JSON."""

from __future__ import annotations

from typing import Any

from rich.table import Table

from estimator.distance import WallMemory
from estimator.run.offline import Tracking
from estimator.sources import Source

_TOLD = (WallMemory.MOVED.value, WallMemory.DROPPED.value)


def summary_of(tracking: Tracking, source: Source, mode: str, seconds: float) -> dict[str, Any]:
    """What `eyespot track --json` prints, except the names of the files written."""
    return {
        "source": source.name,
        "mode": mode,
        "unrelated": source.unrelated,
        "frames": tracking.frames,
        "spots": tracking.spots,
        "no_spot": dict(tracking.no_spot.most_common()),
        "most_significant": tracking.most_significant,
        "distances": tracking.distances,
        "doubtful_distances": tracking.doubtful,
        "wall_memory": tracking.wall_memory,
        "median_pose_age_s": tracking.median_pose_age_s,
        "seconds": round(seconds, 3),
        "ended": tracking.ended.value,
        "fault": tracking.fault,
    }


def table_of(summary: dict[str, Any]) -> Table:
    """The summary as a table."""
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
    notes = []
    notes += [
        f"in {count} of the frames: {_sentence(WallMemory(memory))}"
        for memory, count in summary["wall_memory"].items()
        if memory in _TOLD
    ]
    if summary["unrelated"]:
        notes.append("every image measured by itself; --sequence follows the spot")
    elif "ambiguous" in summary["no_spot"]:
        notes.append("after a jump a spot is ambiguous; --unrelated ignores jumps")
    if summary["most_significant"] is not None:
        notes.append(
            f"faint spots are up to {summary['most_significant']:.1f} times the noise and texture "
            "round them"
        )
    if summary["median_pose_age_s"] is not None:
        notes.append(f"median age of the pose: {1e3 * summary['median_pose_age_s']:.1f} ms")
    table.caption = "\n".join(notes) or None
    return table


def _sentence(memory: WallMemory) -> str:
    return memory.meaning[0].lower() + memory.meaning[1:]
