"""Chooses the free constants of the entries on the split `train`, one constant after another.

The cost of a frame is the error of the semi-minor axis, at most ten pixels, which is also the cost
of a miss. From the first value of each constant, each one in turn takes the value with the least
mean cost, until nothing changes or everything was chosen twice.
"""

from __future__ import annotations

import functools
import math
import multiprocessing
import shlex
import sys
from collections.abc import Sequence
from concurrent.futures import Executor, ProcessPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.paper import VISIBLE_ENOUGH
from benchmarks.rivals.entries import KINDS, unavailable
from benchmarks.rivals.entry import Entry
from benchmarks.rivals.running import measure_stack, write_constants
from benchmarks.sets.read.labelled_set import SetStack
from benchmarks.sets.read.stacks import stacks_of
from benchmarks.study import versions
from estimator import Frame, Spot, open_source
from estimator.files import fingerprint, written_whole
from estimator.run import progress
from optics import InputError

_MOST_PX = 10.0
_ROUNDS = 2
_last: tuple[str, dict[str, Any], Entry] | None = None
_KEPT_STACKS = 32  # whose frames a worker keeps in memory: at 20 frames of 640 x 480, 600 MB


def tune(folder: Path, out: Path, *, entries: Sequence[str], every: int, workers: int) -> None:
    """Choose the constants and write them with their costs.

    Args:
        folder: a set with a split train.
        out: new file.
        entries: names in `KINDS`; those without free constants, or that cannot run, are skipped.
        every: one stack of so many is used.

    Raises:
        InputError: the set has no split train.
    """
    stacks = [entry for entry in stacks_of(folder) if entry.split == "train"][::every]
    if not stacks:
        raise InputError(f"{folder} has no split train. Constants are chosen on nothing else.")
    names = [name for name in entries if KINDS[name].grid and not unavailable(name)]
    found: dict[str, Any] = {}
    spawn = multiprocessing.get_context("spawn")
    with (
        written_whole(out) as partial,
        ProcessPoolExecutor(workers, mp_context=spawn) as pool,
        progress("Tuning", total=len(names)) as advance,
    ):
        for name in names:
            found[name] = _chosen(name, stacks, pool)
            advance(note=f"{name} {found[name]['cost_px']:.2f} px")
        manifest = folder / "manifest.json"
        origin = {
            "command": shlex.join(["eyespot", *sys.argv[1:]]),
            "set": folder.resolve().name,
            "manifest": fingerprint(manifest) if manifest.is_file() else None,
            "stacks": [f"{entry.split}/{entry.name}" for entry in stacks],
            "versions": versions(),
        }
        write_constants(partial, found, origin)
    print(f"Wrote {out}.")


def _chosen(name: str, stacks: Sequence[SetStack], pool: Executor) -> dict[str, Any]:
    """The constants of an entry, with their mean cost and the number of values tried."""
    grid = KINDS[name].grid
    now = {constant: values[0] for constant, values in grid.items()}
    costs: dict[tuple[Any, ...], float] = {}

    def cost(constants: dict[str, Any]) -> float:
        key = tuple(constants.values())
        if key not in costs:
            tasks = [(name, constants, stack) for stack in stacks]
            costs[key] = float(np.mean(np.concatenate(list(pool.map(stack_costs, tasks)))))
        return costs[key]

    for _ in range(_ROUNDS):
        before = dict(now)
        for constant, values in grid.items():
            now[constant] = min(values, key=lambda value: cost(now | {constant: value}))
        if now == before:
            break
    return {"constants": now, "cost_px": round(cost(now), 4), "tried": len(costs)}


@functools.lru_cache(_KEPT_STACKS)
def _kept_frames(folder: Path, exposure: str) -> list[Frame]:
    return list(open_source(folder, exposure=exposure))


def _kept_entry(name: str, constants: dict[str, Any]) -> Entry:
    """The entry of the last call, or a new one: some start a process of their own."""
    global _last
    if _last is None or _last[:2] != (name, constants):
        if _last is not None:
            _last[2].close()
        _last = name, constants, KINDS[name].make(constants, Path())
    return _last[2]


def stack_costs(task: tuple[str, dict[str, Any], SetStack]) -> list[float]:
    """Cost of each frame of a stack whose spot is visible, px."""
    name, constants, stack = task
    entry = _kept_entry(name, constants)
    truth = {labels.file_name: labels for labels in stack.open().labels}
    costs = []
    for answers in measure_stack(stack, name, entry, distances=False, frames=_kept_frames):
        for record in answers.records:
            labels = truth[record.file_name]
            if labels.visible_fraction < VISIBLE_ENOUGH:
                continue
            off = math.inf
            if isinstance(record.result, Spot):
                off = abs(record.result.semi_minor_px - labels.half_max_semi_minor_px)
            costs.append(min(off, _MOST_PX) if math.isfinite(off) else _MOST_PX)
    return costs
