"""Long runs: `eyespot track`, a `Reader` at a camera's pace, and the books of a large set.

Memory and lost frames do not depend on other processes; times do.
"""

from __future__ import annotations

import os
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping
from contextlib import nullcontext
from itertools import cycle, islice
from pathlib import Path
from typing import Any

import numpy as np
from distributed import Client, as_completed
from distributed.scheduler import heartbeat_interval
from skimage.io import imsave

from benchmarks.bench import tracks
from benchmarks.sets.make import Shard, local_workers, make_set, versions
from benchmarks.sets.read import verify_set
from benchmarks.sets.spec import SetSpec, load_spec, plan
from estimator import SubpixelMode, SubpixelSettings
from formats.spots import Spot
from scenes import changed, render_stack
from scenes.drawn import Drawing, any_truth, any_wall, frame_of

_DISTINCT = 60  # drawn frames, which repeat
_RATE_HZ = 30.0
_WARM = 200  # frames before the memory of the start is taken


def memory_mb(process: int | None = None) -> float:
    """Resident memory of a process (default: this one), MB."""
    pages = int(Path(f"/proc/{process or 'self'}/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


@tracks(
    frame_median_ms=lambda run, *_: float(1e3 * np.median(run.seconds)),
    slowest_ms=lambda run, *_: float(1e3 * run.seconds.max()),
    lost=lambda run, *_: run.lost,
    late=lambda run, *_: run.late,
    start_mb=lambda run, *_: run.memory[0],
    middle_mb=lambda run, *_: run.memory[len(run.memory) // 2],
    end_mb=lambda run, *_: run.memory[-1],
)
class _Run:
    """What a long run left: times of its frames (s), memory (MB), frames that were lost or late.

    A frame is late if its result comes after the next frame.
    """

    full = False
    seconds: np.ndarray
    memory: list[float]
    lost = late = 0


def _frames() -> list[np.ndarray]:
    """A spot that moves round on a printed retina."""
    rng = np.random.default_rng(0)
    truth, wall = any_truth(rng, 60.0), any_wall(rng)
    turns = np.linspace(0, 2 * np.pi, _DISTINCT, endpoint=False)
    places = [truth.moved(60 * float(np.cos(t)), 60 * float(np.sin(t))) for t in turns]
    return [frame_of(Drawing(truth=place, wall=wall), rng) for place in places]


class ReaderLoad(_Run):
    """A `Reader` of 640 x 480 px frames: as fast as it can, and at 30 Hz (full: an hour, 300 s)."""

    params = (["as fast as it can", "at 30 Hz"],)
    param_names = ("pace",)

    def setup(self, pace: str) -> None:
        """Read; no frame is skipped, but some may be late."""
        paced = pace == "at 30 Hz"
        number = round((300 if self.full else 20) * _RATE_HZ) if paced else 0
        number = number or (108_000 if self.full else 3_000)
        reader, camera = SubpixelMode(SubpixelSettings(), None), cycle(_frames())
        self.seconds, self.memory, spots = np.empty(number), [], 0
        for image in islice(camera, _WARM):
            reader.read(image)
        began = time.perf_counter()
        for k, image in enumerate(islice(camera, number)):
            due = began + k / _RATE_HZ
            if paced:
                time.sleep(max(due - time.perf_counter(), 0.0))
            start = time.perf_counter()
            spots += isinstance(reader.read(image).result, Spot)
            end = time.perf_counter()
            self.seconds[k] = end - start
            self.late += paced and end - due > 1 / _RATE_HZ
            if k % 30 == 0:
                self.memory.append(memory_mb())
        self.lost = number - spots


class TrackingLoad(_Run):
    """`eyespot track` of a folder of 320 x 240 px, a process of its own (full: 100,000 files)."""

    def setup(self) -> None:
        """Run it; each image has many names. The time of a frame contains the start."""
        number, frames = 100_000 if self.full else 3_000, _frames()
        with tempfile.TemporaryDirectory() as temporary:
            folder, out = Path(temporary) / "frames", Path(temporary) / "spots.csv"
            folder.mkdir()
            for k, image in enumerate(frames):
                imsave(folder / f"{k:06d}.png", image[::2, ::2], check_contrast=False)
            for k in range(len(frames), number):
                os.link(folder / f"{k % len(frames):06d}.png", folder / f"{k:06d}.png")
            code = "import eyespot; eyespot.main()"
            command = [sys.executable, "-c", code, "track", str(folder), "--out", str(out)]
            began = time.perf_counter()
            with subprocess.Popen([*command, "--json"], stdout=subprocess.DEVNULL) as process:
                self.memory = self._memory(process, out.with_name("spots.partial.csv"))
            self.seconds = np.full(1, (time.perf_counter() - began) / number)
            with out.open("rb") as lines:
                self.lost = number - (sum(1 for _ in lines) - 1)

    @staticmethod
    def _memory(process: subprocess.Popen[bytes], lines: Path) -> list[float]:
        """From the first hundred frames on, every quarter of a second."""
        found = []
        while process.poll() is None:
            if lines.exists() and lines.stat().st_size > 50_000:
                try:
                    found.append(memory_mb(process.pid))
                except (OSError, IndexError):  # it has just ended
                    break
            time.sleep(0.25)
        return found


@tracks(
    plan_ms_a_stack=lambda books, stacks: float(books.ms[0]),
    card_and_manifest_ms_a_stack=lambda books, stacks: float(books.ms[1]),
    verify_ms_a_stack=lambda books, stacks: float(books.ms[2]),
    peak_mb=lambda *_: resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3,
)
class Books:
    """A set's books by its stacks, copies of one small stack, so that rendering does not count."""

    params = ([1000, 3000, 10_000],)
    param_names = ("stacks",)
    full = False

    def setup(self, stacks: int) -> None:
        """Plan, make and verify a set whose stacks are there."""
        spec, self.ms = load_spec("static-v1"), np.full(3, np.nan)
        if stacks > 3000 and not self.full:
            return
        with tempfile.TemporaryDirectory() as folder:
            template, out = Path(folder) / "template", Path(folder) / "set"
            scene = plan(spec)[0].scene
            scale = 10 * scene.microscope.scale_mm_px
            coarse = {"width_px": 64, "height_px": 48, "scale_mm_px": scale}
            render_stack(changed(scene, {"motion.frames": 1, "microscope": coarse}), template)
            spec = _sized(spec, stacks)
            times = [time.perf_counter()]
            planned = plan(spec)
            times.append(time.perf_counter())
            none_of_them = Shard(stacks + 1, stacks + 1)
            make_set(spec, out, workers=nullcontext(), shard=none_of_them)  # type: ignore[arg-type]
            for stack in planned:
                shutil.copytree(template, out / stack.split / stack.name)
            copied = time.perf_counter()
            make_set(spec, out, workers=nullcontext())  # type: ignore[arg-type]
            made = time.perf_counter()
            verify_set(out)
            planning, verifying = times[1] - times[0], time.perf_counter() - made
            finishing = made - copied - planning  # it plans again
            self.ms = 1e3 * np.array([planning, finishing, verifying]) / stacks


def _sized(spec: SetSpec, count: int) -> SetSpec:
    """A spec of so many stacks, spread over the splits."""
    train = min(count, 4096)
    validation = min(count - train, 4096)
    numbers = {"train": train, "validation": validation, "test": count - train - validation}
    return spec.model_copy(update={"splits": spec.splits.model_copy(update=numbers)})


@tracks(
    task_ms=lambda scheduler: 1e3 * scheduler.task_s,
    heartbeat_ms=lambda scheduler: 1e3 * scheduler.heartbeat_s,
)
class Scheduler:
    """Processor time of the scheduler's thread; 200 workers are to cost it 5 % of a core."""

    tasks, idle_s, few, more = 2000, 20.0, 2, 8

    def setup(self) -> None:
        """Tasks that do nothing, and the heartbeats of few and of more workers."""
        planned = plan(_sized(load_spec("static-v1"), self.tasks))
        idle = []
        for workers in (self.few, self.more):
            with local_workers(workers) as client:
                client.wait_for_workers(workers)
                if workers == self.few:
                    _submitted(client, planned[:100])
                    began = _thread_s(client)
                    _submitted(client, planned)
                    self.task_s = (_thread_s(client) - began) / len(planned)
                began = _thread_s(client)
                time.sleep(self.idle_s)
                idle.append((_thread_s(client) - began) / self.idle_s)
        self.heartbeat_s = (idle[1] - idle[0]) / (self.more - self.few)
        self.heartbeat_s *= heartbeat_interval(self.more)


def _nothing(scene: Mapping[str, Any], folder: str, wanted: Mapping[str, str]) -> None:
    """Stand-in for `render_planned`."""


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
