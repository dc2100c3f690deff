"""The mode pixels on the stacks of a set with adverse conditions, such as adverse-v2.

    python -m benchmarks.bench.pixel_set FILE.jsonl 8 --seed 77
    python -m benchmarks.bench.pixel_set FILE.jsonl 8 --seed 77 --of 2 --part 1  # beside --part 0

The set has a seed of its own. The mode knows each stack's true beam; the robot says the axis with
an error (`pixel_frames`). A line of the file (`lines`) is a stack.
"""

from __future__ import annotations

import tempfile
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cyclopts
import numpy as np
from cyclopts.types import NonNegativeInt, PositiveInt
from rich.table import Table
from scipy.stats import chi2

from benchmarks.bench.lines import add_line, lines_in
from benchmarks.bench.output import show, table
from benchmarks.bench.pixel_frames import FrameErrors, frame_errors
from benchmarks.bench.pixel_stacks import prepare
from benchmarks.evaluation import rms
from benchmarks.sets.read import true_beam
from benchmarks.sets.spec import PlannedStack, SetSpec, load_spec, plan
from scenes import render_stack

_SPEC = "adverse-v2"
_WELL_BOUND_MM = 0.05
"""Bound of the distance's standard deviation, below which a frame shows the distance well."""
_WRONG = 1e-4
"""Over the number of frames: probability of a chi squared that no honest pose has."""
_WIDTH = 190  # characters of the table


def main(
    file: Path,
    stacks: PositiveInt,
    /,
    *,
    seed: NonNegativeInt = 20261127,
    of: PositiveInt = 1,
    part: NonNegativeInt = 0,
) -> None:
    """Render and read stacks of adverse conditions, and print a table of the conditions.

    Args:
        file: Lines of stacks that were measured; grows.
        stacks: Stacks of each condition.
        seed: Random seed of the set.
        of: Processes that share the stacks.
        part: Which of them this is, from 0.
    """
    prepare()
    have = {(line["seed"], line["stacks"], line["stack"]) for line in lines_in(file)}
    for number, stack in enumerate(_planned(seed, stacks)):
        if number % of == part and (seed, stacks, stack.name) not in have:
            frames = _measured(stack, seed)
            condition = stack.condition or stack.split
            line = {"seed": seed, "stacks": stacks, "stack": stack.name, "condition": condition}
            add_line(file, line | {"frames": [one._asdict() for one in frames]})
    show(_table(lines_in(file)), width=_WIDTH)


def _planned(seed: int, stacks: int) -> list[PlannedStack]:
    """The stacks of the set, conditions by turns; their number changes each of them."""
    spec = load_spec(_SPEC).model_dump(by_alias=True)
    for split in ("adverse", "unseen"):
        spec[split]["stacks"] = stacks
    planned = plan(SetSpec.model_validate(spec | {"seed": seed}))
    return sorted(planned, key=lambda stack: stack.name[-4:])


def _measured(planned: PlannedStack, seed: int) -> list[FrameErrors]:
    rng = np.random.default_rng([seed, planned.scene.seed])
    with tempfile.TemporaryDirectory() as folder:
        stack = render_stack(planned.scene, Path(folder) / planned.name)
        return list(frame_errors(stack, true_beam(stack), rng))


def _table(lines: list[dict[str, Any]]) -> Table:
    frames: dict[str, list[FrameErrors]] = {}
    for line in lines:
        own = frames.setdefault(line["condition"], [])
        own += [FrameErrors(**frame) for frame in line["frames"]]
    whole = [one for own in frames.values() for one in own]
    limit = chi2.isf(_WRONG / len(whole), 5)
    made = table(
        f"mode pixels on {_SPEC}, {len(lines)} stacks with seeds of their own",
        *("condition", "frames", "sub-pixel", "of these, pixels", "missed, well bound"),
        *("of these, pixels", "pixels", "why not"),
        *("d RMS, µm", "median", "stated", "chi²_5 / 5", "largest chi²_5", "wrong"),
        caption=f"well bound: {1e3 * _WELL_BOUND_MM:g} µm of distance or less; wrong: chi squared "
        f"above {limit:.0f} (p = {_WRONG:g} over {len(whole):,} frames)",
    )
    for name, some in [*frames.items(), ("all", whole)]:
        made.add_row(name, *_row(some, limit))
    return made


def _row(some: list[FrameErrors], limit: float) -> Iterator[str]:
    found = [one for one in some if one.found]
    missed = [one for one in some if not one.found and one.bound_mm < _WELL_BOUND_MM]
    posed = [one for one in some if one.posed]
    doubts = Counter(one.doubt for one in some if one.doubt)
    squares = np.array([one.chi_squared for one in posed])
    yield f"{len(some)}"
    yield f"{len(found)}"
    yield f"{sum(one.posed for one in found)}"
    yield f"{len(missed)}"
    yield f"{sum(one.posed for one in missed)}"
    yield f"{len(posed)}"
    yield ", ".join(f"{doubt} {count}" for doubt, count in doubts.most_common())
    yield f"{1e3 * rms(one.distance_mm for one in posed):.1f}"
    yield f"{1e3 * np.median([abs(one.distance_mm) for one in posed]):.1f}" if posed else "nan"
    yield f"{1e3 * rms(one.sigma_mm for one in posed):.1f}"
    yield f"{squares.mean() / 5:.2f}" if posed else "nan"
    yield f"{squares.max():.1f}" if posed else "nan"
    yield f"{np.count_nonzero(squares > limit)}"


if __name__ == "__main__":
    cyclopts.run(main)
