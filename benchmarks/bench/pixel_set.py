"""The mode pixels on the stacks of a set with adverse conditions, such as adverse-v2.

    python -m benchmarks.bench.pixel_set FILE.jsonl 8 --seed 77
    python -m benchmarks.bench.pixel_set FILE.jsonl 8 --seed 77 --of 2 --part 1  # beside --part 0

The set has a seed of its own. The mode knows each stack's true beam; the robot says the axis with
an error (`pixel_frames`). A line of the file (`lines`) is a stack.
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import cyclopts
import numpy as np
from cyclopts.types import NonNegativeInt, PositiveInt
from rich.table import Table
from scipy.stats import chi2

from benchmarks.bench.output import add_line, lines_in, rows_table, show
from benchmarks.bench.pixel_frames import Row, as_table, frame_errors, prepare, sizes
from benchmarks.reporting import grouped
from benchmarks.sets.read.stacks import true_beam
from benchmarks.sets.spec.planning import PlannedStack, plan
from benchmarks.sets.spec.spec import SetSpec, load_spec
from scenes import render_stack

_SPEC = "adverse-v2"
_WELL_BOUND_MM = 0.05
"""Bound of the distance's standard deviation, below which a frame shows the distance well."""
_WRONG = 1e-4
"""Over the number of frames: probability of a chi squared that no honest pose has."""
_WIDTH = 210  # characters of the table


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
            add_line(file, line | {"frames": frames})
    show(_table(lines_in(file)), width=_WIDTH)


def _planned(seed: int, stacks: int) -> list[PlannedStack]:
    """The stacks of the set, conditions by turns; their number changes each of them."""
    spec = load_spec(_SPEC).model_dump(by_alias=True)
    for split in ("adverse", "unseen"):
        spec[split]["stacks"] = stacks
    planned = plan(SetSpec.model_validate(spec | {"seed": seed}))
    return sorted(planned, key=lambda stack: stack.name[-4:])


def _measured(planned: PlannedStack, seed: int) -> list[Row]:
    rng = np.random.default_rng([seed, planned.scene.seed])
    with tempfile.TemporaryDirectory() as folder:
        stack = render_stack(planned.scene, Path(folder) / planned.name)
        return list(frame_errors(stack, true_beam(stack), rng))


def _table(lines: list[dict[str, Any]]) -> Table:
    whole = as_table(
        frame | {"condition": line["condition"]} for line in lines for frame in line["frames"]
    )
    limit = chi2.isf(_WRONG / len(whole), 5)
    rows = []
    for name, some in [*grouped(whole, "condition"), ("all", whole)]:
        missed = some[~some.found & (some.bound_mm < _WELL_BOUND_MM)]
        squares = some.chi_squared[some.posed]
        doubts = some.doubt[some.doubt != ""].value_counts()
        rows.append(
            {
                "condition": name,
                "frames": len(some),
                "sub-pixel": some.found.sum(),
                "of these, pixels": (some.found & some.posed).sum(),
                "missed, well bound": len(missed),
                "of those, pixels": missed.posed.sum(),
                "pixels": some.posed.sum(),
                "why not": ", ".join(f"{doubt} {count}" for doubt, count in doubts.items()),
                **sizes(some),
                "largest chi²_5": f"{squares.max():.1f}",
                "wrong": (squares > limit).sum(),
            }
        )
    return rows_table(
        f"mode pixels on {_SPEC}, {len(lines)} stacks with seeds of their own",
        rows,
        caption=f"well bound: {1e3 * _WELL_BOUND_MM:g} µm of distance or less; wrong: chi squared "
        f"above {limit:.0f} (p = {_WRONG:g} over {len(whole):,} frames)",
    )


if __name__ == "__main__":
    cyclopts.run(main)
