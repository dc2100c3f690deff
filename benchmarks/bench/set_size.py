"""How the cost of a set grows: with its stacks (plan, manifest, verify), and with its workers.

The stacks are stand-ins, copies of one small rendered stack, so that the books of the set are
measured and not the renderer. The tasks of the scheduler are stand-ins that do nothing.
"""

from __future__ import annotations

import resource
import shutil
import tempfile
import time
from collections.abc import Iterator, Mapping
from contextlib import nullcontext
from pathlib import Path
from typing import Any

from distributed import Client, as_completed
from distributed.scheduler import heartbeat_interval

from benchmarks.bench.output import show, table
from benchmarks.sets.make.cluster import local_workers
from benchmarks.sets.make.generate import Shard, make_set
from benchmarks.sets.make.manifest import verify_set
from benchmarks.sets.make.worker import versions
from benchmarks.sets.spec.planning import plan
from benchmarks.sets.spec.spec import SetSpec, load_spec
from scenes import changed, render_stack

_SIZES = (1000, 3000, 10000)
_TASKS = 2000
_WORKERS = 200
_MOST = 0.05  # of a core, for the scheduler of so many workers
_IDLE_S = 20.0
_FEW, _MORE = 2, 8  # workers whose heartbeats are compared


def run(*, full: bool) -> None:
    """Print seconds and memory by number of stacks, and the scheduler's load (`full`: 10,000)."""
    spec = load_spec("static-v1")
    with tempfile.TemporaryDirectory() as folder:
        sizes = table(
            "a set's books, ms per stack",
            *("stacks", "plan", "card and manifest", "verify", "peak MB of the process"),
        )
        template, render_s = _template(spec, Path(folder))
        for count in _SIZES if full else _SIZES[:2]:
            sizes.add_row(*_books(_sized(spec, count), template, Path(folder) / f"{count}"))
    task_s, heartbeat_s = _scheduler(spec)
    tasks = _WORKERS * task_s / render_s
    heartbeats = _WORKERS * heartbeat_s / heartbeat_interval(_WORKERS)
    show(
        sizes,
        f"scheduler: {1e3 * task_s:.2f} ms of processor a task, and a stack takes {render_s:.1f} s",
        f"{_WORKERS} workers: {100 * tasks:.1f} % of a core for their tasks (limit "
        f"{100 * _MOST:.0f} %), {100 * heartbeats:.0f} % for Dask's heartbeats of "
        f"{1e3 * heartbeat_s:.2f} ms",
    )


def _sized(spec: SetSpec, count: int) -> SetSpec:
    """A spec of so many stacks, spread over the splits."""
    train = min(count, 4096)
    validation = min(count - train, 4096)
    numbers = {"train": train, "validation": validation, "test": count - train - validation}
    return spec.model_copy(update={"splits": spec.splits.model_copy(update=numbers)})


def _template(spec: SetSpec, folder: Path) -> tuple[Path, float]:
    """A stack of one small frame to be copied, and the seconds that a stack of the set takes."""
    scene = plan(spec)[0].scene
    coarse = {"width_px": 64, "height_px": 48, "scale_mm_px": 10 * scene.microscope.scale_mm_px}
    small = changed(scene, {"motion.frames": 1, "microscope": coarse})
    render_stack(small, folder / "template")
    render_stack(scene, folder / "warm")
    began = time.process_time()
    render_stack(scene, folder / "measured")
    return folder / "template", time.process_time() - began


def _books(spec: SetSpec, template: Path, out: Path) -> Iterator[str]:
    began = time.perf_counter()
    planned = plan(spec)
    planning = time.perf_counter() - began
    count = len(planned)
    none_of_them = Shard(count + 1, count + 1)
    make_set(spec, out, workers=nullcontext(), shard=none_of_them)  # type: ignore[arg-type]
    for stack in planned:
        shutil.copytree(template, out / stack.split / stack.name)
    began = time.perf_counter()
    make_set(spec, out, workers=nullcontext())  # type: ignore[arg-type]
    finishing = time.perf_counter() - began - planning  # it plans again
    began = time.perf_counter()
    verify_set(out)
    verifying = time.perf_counter() - began
    shutil.rmtree(out)
    yield f"{count:,}"
    yield from (f"{1e3 * seconds / count:.2f}" for seconds in (planning, finishing, verifying))
    yield f"{resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3:.0f}"


def _nothing(scene: Mapping[str, Any], folder: str, wanted: Mapping[str, str]) -> None:
    """Stand-in for `render_planned`."""


def _scheduler(spec: SetSpec) -> tuple[float, float]:
    """Processor seconds of the scheduler's thread for a task, and for a worker's heartbeat."""
    planned = plan(_sized(spec, _TASKS))
    with local_workers(_FEW) as client:
        client.wait_for_workers(_FEW)
        _submitted(client, planned[:100])
        began = _thread_s(client)
        _submitted(client, planned)
        task_s = (_thread_s(client) - began) / len(planned)
        few = _idle_load(client)
    with local_workers(_MORE) as client:
        client.wait_for_workers(_MORE)
        more = _idle_load(client)
    return task_s, (more - few) / (_MORE - _FEW) * heartbeat_interval(_MORE)


def _idle_load(client: Client) -> float:
    began = _thread_s(client)
    time.sleep(_IDLE_S)
    return (_thread_s(client) - began) / _IDLE_S


def _thread_s(client: Client) -> float:
    return float(client.run_on_scheduler(time.thread_time))


def _submitted(client: Client, planned: list[Any]) -> None:
    tasks = client.map(
        _nothing,
        [stack.scene.model_dump(mode="json", by_alias=True) for stack in planned],
        [stack.name for stack in planned],
        wanted=versions(),
        pure=False,
    )
    for _ in as_completed(tasks):
        pass
