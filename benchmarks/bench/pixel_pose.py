"""Accuracy of the mode pixels on rendered stacks, with its stated errors and the other modes.

Frames from the fifth on use what the earlier ones showed of the wall (`pixel_stacks`).
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
from rich.table import Table

from benchmarks.bench.output import show, table
from benchmarks.bench.pixel_frames import FrameErrors
from benchmarks.bench.pixel_stacks import BEAMS, WALLS, Circumstances, drawn_errors, prepare
from benchmarks.evaluation import rms
from benchmarks.studies.pose import PRIOR_DEG

_FRAMES, _LATER = 12, 4  # frames from the fifth on have numbers from 4
_STACKS, _STACKS_FULL = 1, 4
_WIDTH = 190  # characters of the widest table
_BOUND = {"exposures": {"kinds": ["metered"], "bound": True}}


def run(*, full: bool) -> None:
    """Render, read, and print the errors (`full` draws more stacks)."""
    prepare()
    rng = np.random.default_rng(20261123)
    frames: dict[tuple[str, str], list[FrameErrors]] = {}
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


def _errors(frames: dict[tuple[str, str], list[FrameErrors]]) -> Table:
    made = table(
        f"mode pixels on single frames and from the fifth on; axis told to {PRIOR_DEG:g}°",
        *("beam", "wall", "frames", "with a pose", "doubtful", "d RMS, µm", "stated", "bound"),
        *("tip, µm", "axis, °", "stated", "chi²_5 / 5", "e₁′, px", "sub-pixel", "literal"),
        "ms, median",
        caption="bound: of Cramér and Rao, for the distance from the spot's ellipse on a wall that "
        "is known; e₁′: semi-minor axis of the half-maximum ellipse; nan: no spot, as by the "
        "literal mode, whose threshold is for the paper's exposure",
    )
    for (beam, wall), own in frames.items():
        groups = {
            "first": [one for one in own if one.frame == 0],
            "5th on": [one for one in own if one.frame >= _LATER],
        }
        for name, some in groups.items():
            posed = [one for one in some if one.posed]
            made.add_row(
                beam,
                wall,
                name,
                f"{len(posed)} of {len(some)}",
                f"{sum(bool(one.doubt) for one in some)}",
                f"{1e3 * rms([one.distance_mm for one in posed]):.1f}",
                f"{1e3 * rms([one.sigma_mm for one in posed]):.1f}",
                f"{1e3 * rms([one.bound_mm for one in posed]):.1f}",
                f"{1e3 * rms([one.tip_mm for one in posed]):.1f}",
                f"{rms([one.axis_deg for one in posed]):.3f}",
                f"{rms([one.sigma_axis_deg for one in posed]):.3f}",
                f"{np.mean([one.chi_squared for one in posed]) / 5:.2f}",
                f"{rms([one.half_maximum_px for one in posed]):.2f}",
                f"{rms([one.subpixel_px for one in posed]):.2f}",
                f"{rms([one.literal_px for one in posed]):.2f}",
                f"{1e3 * np.median([one.seconds for one in some]):.0f}",
            )
    return made
