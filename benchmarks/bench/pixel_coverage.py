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
from cyclopts.types import NonNegativeInt, PositiveInt
from rich.table import Table
from scipy.stats import binom, chi2

from benchmarks.bench.lines import add_line, lines_in
from benchmarks.bench.output import show, table
from benchmarks.bench.pixel_stacks import BEAMS, WALLS, Circumstances, drawn_errors, prepare

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
    return {"seed": seed, "wall": wall, "number": number, "beam": beam} | first._asdict()


def _table(lines: list[dict[str, Any]]) -> Table:
    made = table(
        "first frames, one a stack: within the stated errors",
        *("wall", "stacks", "with a pose", "d RMS, µm", "median"),
        *(f"{what} in {share}" for what in ("d", "tip", "axis", "pose") for share in ("68", "95")),
        *("largest chi²_5", "wrong"),
        caption="percent of the errors within the stated 68 % and 95 % regions; in brackets, 99 % "
        "limits of an honest estimator; wrong: chi squared beyond p = "
        f"{_WRONG:g} over the number of frames",
    )
    for wall in WALLS:
        some = [line for line in lines if line["wall"] == wall]
        posed = [
            one for one in some if one["distance_mm"] == one["distance_mm"] and not one["doubt"]
        ]
        if not posed:
            continue
        d, sigma = (np.array([one[key] for one in posed]) for key in ("distance_mm", "sigma_mm"))
        pose, tip, axis = (
            np.array([one[key] for one in posed])
            for key in ("chi_squared", "tip_chi_squared", "axis_chi_squared")
        )
        limit = chi2.isf(_WRONG / len(posed), 5)
        made.add_row(
            wall,
            f"{len(some)}",
            f"{len(posed)}",
            f"{1e3 * np.sqrt(np.mean(d**2)):.1f}",
            f"{1e3 * np.median(np.abs(d)):.1f}",
            *(
                _share(squares < chi2.ppf(level, numbers), level)
                for squares, numbers in (((d / sigma) ** 2, 1), (tip, 3), (axis, 2), (pose, 5))
                for level in _LEVELS
            ),
            f"{pose.max():.1f}",
            f"{np.count_nonzero(pose > limit)}",
        )
    return made


def _share(inside: np.ndarray, level: float) -> str:
    low, high = 100 * binom.ppf([0.005, 0.995], len(inside), level) / len(inside)
    return f"{100 * inside.mean():.0f} [{low:.0f}-{high:.0f}]"


if __name__ == "__main__":
    cyclopts.run(main)
