"""Time to render a labelled set: one process, one worker, two workers.

The frames are those of static-v1. Processor time hardly depends on other processes. Wall time does,
so its ratios need two idle cores.
"""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import nullcontext
from multiprocessing import get_context
from pathlib import Path
from typing import NamedTuple

from distributed import Client
from rich.table import Table

from benchmarks.bench.output import memory_mb, show, table
from benchmarks.sets.make import local_workers, make_set
from benchmarks.sets.spec import SetSpec, load_spec, plan
from scenes import Scene, frame_count, load_mitsuba, render_stack

_STACKS = 8  # measured stacks, the same for all runs
_WARM = 4  # stacks with another seed that each process renders first, to compile kernels
_WANTED_FRAMES = 2000
_BOUNDS = {"overhead": 1.15, "speed-up": 1.7, "seconds": 180.0}


class Made(NamedTuple):
    """Seconds for some frames, and memory of each process after each stack (MB)."""

    name: str
    frames: int
    start_s: float  # until every process has rendered its first stacks
    wall_s: float
    processor_s: float
    memory_mb: list[list[float]]

    @property
    def frame_ms(self) -> float:
        """Processor time per frame."""
        return 1e3 * self.processor_s / self.frames

    @property
    def growth(self) -> float:
        """Memory of the largest process at the end, relative to the middle of the run."""
        last, middle = self.memory_mb[-1], self.memory_mb[len(self.memory_mb) // 2]
        return max(last) / max(middle)


def run(*, full: bool) -> None:
    """Print times and their ratios (`full` changes nothing)."""
    load_mitsuba()  # fails early on a machine that cannot render
    spec = load_spec("static-v1")
    with tempfile.TemporaryDirectory() as folder:
        alone = _alone(spec, Path(folder) / "alone")
        one, two = (_with_workers(spec, n, Path(folder) / f"set-{n}") for n in (1, 2))
    seconds = two.start_s + _WANTED_FRAMES / two.frames * two.wall_s
    show(
        _table([alone, one, two]),
        f"processor time per frame over a single process: {one.frame_ms / alone.frame_ms:.2f}"
        f" with one worker, {two.frame_ms / alone.frame_ms:.2f} with two (limit "
        f"{_BOUNDS['overhead']:.2f})",
        f"two workers are {one.wall_s / two.wall_s:.2f} times as fast as one (at least "
        f"{_BOUNDS['speed-up']:.1f} expected)",
        f"{_WANTED_FRAMES:,} frames with two workers, extrapolated: {seconds:.0f} s (limit "
        f"{_BOUNDS['seconds']:.0f} s)",
        f"load of the machine at the end: {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores",
    )


def _warm(spec: SetSpec) -> SetSpec:
    return _stacks(spec, _WARM, spec.seed + 1)


def _measured(spec: SetSpec) -> SetSpec:
    return _stacks(spec, _STACKS, spec.seed)


def _stacks(spec: SetSpec, count: int, seed: int) -> SetSpec:
    splits = spec.splits.model_copy(update={"train": count, "validation": 0, "test": 0})
    return spec.model_copy(update={"splits": splits, "seed": seed})


def _alone(spec: SetSpec, folder: Path) -> Made:
    """The same stacks in one process on one core."""
    with ProcessPoolExecutor(1, get_context("spawn"), _stay_on_one_core) as process:
        warm, measured = (
            [stack.scene for stack in plan(part)] for part in (_warm(spec), _measured(spec))
        )
        return process.submit(_rendered, warm, measured, folder).result()


def _stay_on_one_core() -> None:
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})


def _rendered(first: Sequence[Scene], scenes: Sequence[Scene], folder: Path) -> Made:
    begin = time.perf_counter()
    _render_all(first, folder)
    warm, processor = time.perf_counter(), time.process_time()
    memory = []
    for number, scene in enumerate(scenes):
        render_stack(scene, folder / f"{number}")
        memory.append([memory_mb()])
    wall, used = time.perf_counter() - warm, time.process_time() - processor
    frames = sum(frame_count(scene) for scene in scenes)
    return Made("one process", frames, warm - begin, wall, used, memory)


def _render_all(scenes: Sequence[Scene], folder: Path) -> None:
    for number, scene in enumerate(scenes):
        render_stack(scene, folder / f"warm-{os.getpid()}-{number}")


def _with_workers(spec: SetSpec, count: int, folder: Path) -> Made:
    begin = time.perf_counter()
    with local_workers(count) as client:
        client.wait_for_workers(count)
        first = [stack.scene for stack in plan(_warm(spec))]
        client.run(_render_all, first, folder)
        warm, processor = time.perf_counter(), _processor_s(client)
        memory, moments = [], []

        def stack_done(done: int, total: int) -> None:
            moments.append(time.perf_counter())
            memory.append(list(client.run(memory_mb).values()))

        measured = _measured(spec)
        make_set(measured, folder / "set", workers=nullcontext(client), progress=stack_done)
        wall, used = moments[-1] - warm, _processor_s(client) - processor
    frames = sum(frame_count(stack.scene) for stack in plan(measured))
    name = f"{count} worker" + "s" * (count > 1)
    return Made(name, frames, warm - begin, wall, used, memory[1:])


def _processor_s(client: Client) -> float:
    return sum(client.run(time.process_time).values())


def _table(made: Sequence[Made]) -> Table:
    title = f"{made[0].frames} frames of static-v1, including the set-up of each stack"
    columns = ("start s", "wall s", "processor ms/frame", "MB per process", "MB end/middle")
    times = table(title, "", *columns)
    for one in made:
        times.add_row(
            one.name,
            f"{one.start_s:.1f}",
            f"{one.wall_s:.1f}",
            f"{one.frame_ms:.0f}",
            f"{max(one.memory_mb[-1]):.0f}",
            f"{one.growth:.3f}",
        )
    return times
