"""Whether the stated errors of the mode pixels hold: many stacks of one frame, a draw each.

    python -m benchmarks.bench.pixel_coverage FILE.jsonl 500
    python -m benchmarks.bench.pixel_coverage FILE.jsonl 500 --of 2 --part 1    # beside --part 0

A line of the file (`lines`) is a frame of one beam and one wall.
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import cyclopts
import numpy as np
import pandas as pd
from cyclopts.types import NonNegativeInt, PositiveInt
from rich.table import Table
from scipy.stats import binom, chi2

from benchmarks.bench.output import add_line, lines_in, rows_table, show
from benchmarks.bench.pixel_frames import (
    BEAMS,
    WALLS,
    Circumstances,
    as_table,
    drawn_errors,
    prepare,
    sizes,
)
from benchmarks.reporting import grouped

_WIDTH = 190  # characters of the table
_LEVELS = 0.6827, 0.95
_WRONG = 1e-4
"""Over the number of frames: probability of a chi squared that no honest pose has."""


def main(
    file: Path,
    stacks: PositiveInt,
    /,
    *,
    seed: NonNegativeInt = 20261124,
    of: PositiveInt = 1,
    part: NonNegativeInt = 0,
) -> None:
    """Render and read single frames, and print how many are within their stated errors.

    Args:
        file: Lines of frames that were measured; grows.
        stacks: Stacks on each wall, of all beams.
        seed: Random seed of the stacks.
        of: Processes that share the stacks.
        part: Which of them this is, from 0.
    """
    prepare()
    have = {(line["seed"], line["wall"], line["number"]) for line in lines_in(file)}
    for number in range(part, stacks, of):
        for wall in WALLS:
            if (seed, wall, number) not in have:
                add_line(file, _measured(seed, wall, number))
    show(_table(lines_in(file)), width=_WIDTH)


def _measured(seed: int, wall: str, number: int) -> dict[str, Any]:
    rng = np.random.default_rng([seed, WALLS.index(wall), number])
    beam = list(BEAMS)[number % len(BEAMS)]
    motion = "hand" if number % 2 else "withdrawal"
    with tempfile.TemporaryDirectory() as folder:
        what = Circumstances(beam, wall, motion, 1)
        first = next(drawn_errors(what, rng, Path(folder) / "stack"))
    return {"seed": seed, "wall": wall, "number": number, "beam": beam} | first


def _table(lines: list[dict[str, Any]]) -> Table:
    rows = []
    for wall, some in grouped(as_table(lines), "wall"):
        posed = some[some.posed]
        limit = chi2.isf(_WRONG / max(len(posed), 1), 5)
        squares = {
            "d": ((posed.distance_mm / posed.sigma_mm) ** 2, 1),
            "tip": (posed.tip_chi_squared, 3),
            "axis": (posed.axis_chi_squared, 2),
            "pose": (posed.chi_squared, 5),
        }
        rows.append(
            {
                "wall": wall,
                "stacks": len(some),
                "with a pose": len(posed),
                "d RMS, µm": sizes(some)["d RMS, µm"],
                "median": sizes(some)["median"],
                **{
                    f"{name} in {100 * level:.0f}": _share(of < chi2.ppf(level, numbers), level)
                    for name, (of, numbers) in squares.items()
                    for level in _LEVELS
                },
                "largest chi²_5": f"{posed.chi_squared.max():.1f}",
                "wrong": (posed.chi_squared > limit).sum(),
            }
        )
    return rows_table(
        "first frames, one a stack: within the stated errors",
        rows,
        caption="percent of the errors within the stated 68 % and 95 % regions; in brackets, 99 % "
        "limits of an honest estimator; wrong: chi squared beyond p = "
        f"{_WRONG:g} over the number of frames",
    )


def _share(inside: pd.Series, level: float) -> str:
    if not len(inside):
        return ""
    low, high = 100 * binom.ppf([0.005, 0.995], len(inside), level) / len(inside)
    return f"{100 * inside.mean():.0f} [{low:.0f}-{high:.0f}]"


if __name__ == "__main__":
    cyclopts.run(main)
