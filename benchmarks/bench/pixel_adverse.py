"""The mode pixels where the world is not as it believes: beams, walls, cameras, other tools.

Each row is a few stacks on printed paper and on a drawn retina (`pixel_frames`). A pose that is
far off and not doubtful is a silent error; frames that the sub-pixel mode measures should be
measured here too.
"""

from __future__ import annotations

import tempfile
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table

from benchmarks.bench.output import rows_table, show
from benchmarks.bench.pixel_frames import Circumstances, Row, as_table, drawn_errors, prepare, sizes

_FRAMES = 8
_BEAMS, _WALLS = ("cone", "dome, vitreous"), ("printed paper", "retina")
_WIDTH = 150  # characters of the table
_SILENT = 36.0
"""Chi squared of five numbers, above which a pose is silently wrong: once in a million."""


@dataclass(frozen=True)
class _Adverse:
    """A row: what is unlike the other benches."""

    tables: dict[str, dict[str, Any]] = field(default_factory=dict)
    sigmas: dict[str, float] = field(default_factory=dict)
    beams: tuple[str, ...] = _BEAMS


_ROWS = {
    "as it should be": _Adverse(),
    "lens known to 0.5 %": _Adverse(
        sigmas={"numerical_aperture": 0.005, "sag": 0.005}, beams=_BEAMS[1:]
    ),
    # The tip is known to 0.5 % of its distance from the apex, 5 mm behind it: 40 um.
    "cone known to 0.5 %": _Adverse(sigmas={"k": 0.005, "b": 0.005}, beams=_BEAMS[:1]),
    "shake 1 px, power 5 %": _Adverse({"unrest": {"shake_px": 1.0, "power_swing": 0.05}}),
    "eye turns, 5°/s": _Adverse({"unrest": {"rotation_deg_s": (4.0, 3.0, 0.0)}}),
    "microscope drifts, 0.7 mm/s": _Adverse({"unrest": {"drift_mm_s": (0.6, 0.3)}}),
    "wet wall": _Adverse({"phantom": {"coat": "wet"}}),
    "defocus, 0.5 mm at NA 0.05": _Adverse(
        {"microscope": {"numerical_aperture": 0.05, "focus_mm": 0.5, "samples": 64}}
    ),
    "Bayer": _Adverse({"camera": {"bayer": "RGGB"}}),
    "JPEG 90": _Adverse({"camera": {"jpeg_quality": 90}}),
    "instrument in view": _Adverse({"instrument": {"visible": True}}),
    "a second tool": _Adverse({"second_tool": {"visible": True}}),
}


def run(*, full: bool) -> None:
    """Render, read, and print the errors (`full` draws three times as many stacks)."""
    prepare()
    frames: dict[str, list[Row]] = {}
    with tempfile.TemporaryDirectory() as folder:
        for name, row in _ROWS.items():
            rng, own = np.random.default_rng(7), frames.setdefault(name, [])  # the same draws
            for number in range(3 if full else 1):
                for beam in row.beams:
                    for wall in _WALLS:
                        motion = "hand" if number % 2 else "withdrawal"
                        tables = _of_wall(row.tables, wall)
                        what = Circumstances(beam, wall, motion, _FRAMES, tables, row.sigmas)
                        own += drawn_errors(what, rng, Path(folder) / f"{name} {len(own)}")
    show(_table(frames), width=_WIDTH)


def _of_wall(tables: dict[str, dict[str, Any]], wall: str) -> dict[str, dict[str, Any]]:
    """The tables, with the wall in the same one."""
    more = {"phantom": {"wall": wall}}
    return {name: own | more.get(name, {}) for name, own in tables.items()}


def _table(frames: dict[str, list[Row]]) -> Table:
    rows = []
    for name, own in frames.items():
        some = as_table(own)
        moved, dropped = ((some.memory == memory).sum() for memory in ("moved", "dropped"))
        rows.append(
            {
                "circumstance": name,
                "frames": len(some),
                "sub-pixel": some.found.sum(),
                "pixels": some.posed.sum(),
                "doubtful": (some.doubt != "").sum(),
                "wall moved / dropped": f"{moved} / {dropped}",
                **sizes(some),
                "silently wrong": (some.chi_squared[some.posed] > _SILENT).sum(),
            }
        )
    return rows_table(
        f"mode pixels, {len(_BEAMS)} beams on {len(_WALLS)} walls",
        rows,
        caption=f"silently wrong: chi squared of the pose above {_SILENT:g}; median, of |error|",
    )
