"""Accuracy of the mode pixels on rendered stacks, with its stated errors and the other modes.

Frames from the fifth on use what the earlier ones showed of the wall (`pixel_frames`).
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
from rich.table import Table

from benchmarks.bench.output import rows_table, show
from benchmarks.bench.pixel_frames import (
    BEAMS,
    WALLS,
    Circumstances,
    Row,
    as_table,
    drawn_errors,
    prepare,
    sizes,
)
from benchmarks.paper import rms
from benchmarks.studies.pose import PRIOR_DEG

_FRAMES, _LATER = 12, 4  # frames from the fifth on have numbers from 4
_STACKS, _STACKS_FULL = 1, 4
_WIDTH = 190  # characters of the widest table
_BOUND = {"exposures": {"kinds": ["metered"], "bound": True}}


def run(*, full: bool) -> None:
    """Render, read, and print the errors (`full` draws more stacks)."""
    prepare()
    rng = np.random.default_rng(20261123)
    frames: dict[tuple[str, str], list[Row]] = {}
    with tempfile.TemporaryDirectory() as folder:
        for number in range(_STACKS_FULL if full else _STACKS):
            motion = "hand" if number % 2 else "withdrawal"
            for beam in BEAMS:
                for wall in WALLS:
                    # The bound takes the wall as known, so that it is one on an even wall only.
                    tables = _BOUND if wall == "uniform" else {}
                    what = Circumstances(beam, wall, motion, _FRAMES, tables)
                    place = Path(folder) / f"{number} {beam} {wall}"
                    frames.setdefault((beam, wall), []).extend(drawn_errors(what, rng, place))
    show(_errors(frames), width=_WIDTH)


def _errors(frames: dict[tuple[str, str], list[Row]]) -> Table:
    rows = []
    for (beam, wall), own in frames.items():
        every = as_table(own)
        groups = {"first": every[every.frame == 0], "5th on": every[every.frame >= _LATER]}
        for name, some in groups.items():
            posed = some[some.posed]
            rows.append(
                {
                    "beam": beam,
                    "wall": wall,
                    "frames": name,
                    "with a pose": f"{len(posed)} of {len(some)}",
                    "doubtful": (some.doubt != "").sum(),
                    **sizes(some),
                    "bound, µm": f"{1e3 * rms(posed.bound_mm):.1f}",
                    "stated, °": f"{rms(posed.sigma_axis_deg):.3f}",
                    "e₁′, px": f"{rms(posed.half_maximum_px):.2f}",
                    "sub-pixel": f"{rms(posed.subpixel_px):.2f}",
                    "literal": f"{rms(posed.literal_px):.2f}",
                    "ms, median": f"{1e3 * some.seconds.median():.0f}",
                }
            )
    return rows_table(
        f"mode pixels on single frames and from the fifth on; axis told to {PRIOR_DEG:g}°",
        rows,
        caption="bound: of Cramér and Rao, for the distance from the spot's ellipse on a wall that "
        "is known; e₁′: semi-minor axis of the half-maximum ellipse; nan: no spot, as by the "
        "literal mode, whose threshold is for the paper's exposure",
    )
