"""Long runs: `eyespot track`, a `Reader` at a camera's pace, and the books of a large set.

Memory and lost frames do not depend on other processes; times do.
"""

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
import pandas as pd
from distributed import Client, as_completed
from distributed.scheduler import heartbeat_interval
from skimage.io import imsave

from eyespot.benchmarks.sets.make import make_set, versions
from eyespot.benchmarks.sets.read import verify_set
from eyespot.benchmarks.sets.spec import SetSpec, load_spec, plan
from eyespot.benchmarks.sets.workers import local_workers
from eyespot.estimator import Frame, SubpixelMode, SubpixelSettings
from eyespot.formats.spot import Spot
from eyespot.scenes import changed, render_stack
from eyespot.scenes.drawn import Drawing, any_truth, any_wall, frame_of

_DRAWN_FRAMES = 60  # They repeat.
_RATE_HZ = 30.0
_WARM_UP_FRAMES = 200  # The memory of the start is taken after them.


def memory_mb(process: int | None = None) -> float:
    """Resident memory of a process (default: this one), MB."""
    pages = int(Path(f"/proc/{process or 'self'}/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def _of_run(seconds: np.ndarray, memory: list[float], *, lost: int, late: int = 0) -> pd.Series:
    """What a long run left; a frame is late if its result comes after the next frame."""
    return pd.Series(
        {
            "frame_median_ms": 1e3 * np.median(seconds),
            "slowest_ms": 1e3 * seconds.max(),
            "lost": lost,
            "late": late,
            "start_mb": memory[0],
            "middle_mb": memory[len(memory) // 2],
            "end_mb": memory[-1],
        }
    )


def _frames() -> list[np.ndarray]:
    """A spot that moves round on a printed retina."""
    rng = np.random.default_rng(0)
    truth, wall = any_truth(rng, 60.0), any_wall(rng)
    turns = np.linspace(0, 2 * np.pi, _DRAWN_FRAMES, endpoint=False)
    places = [truth.moved(60 * float(np.cos(t)), 60 * float(np.sin(t))) for t in turns]
    return [frame_of(Drawing(truth=place, wall=wall), rng) for place in places]


def reader_load(full: bool = False) -> pd.DataFrame:
    """A `Reader` of 640 x 480 px frames: as fast as it can, and at 30 Hz (full: an hour, 300 s).

    No frame is skipped, but some may be late.
    """
    rows = {}
    for paced in (False, True):
        number = round((300 if full else 20) * _RATE_HZ) if paced else 0
        number = number or (108_000 if full else 3_000)
        reader, camera = SubpixelMode(SubpixelSettings(), None), cycle(_frames())
        seconds, memory, spots, late = np.empty(number), [], 0, 0
        for image in islice(camera, _WARM_UP_FRAMES):
            reader.read(Frame(index=0, image=image))
        began = time.perf_counter()
        for k, image in enumerate(islice(camera, number)):
            due = began + k / _RATE_HZ
            if paced:
                time.sleep(max(due - time.perf_counter(), 0.0))
            start = time.perf_counter()
            spots += isinstance(reader.read(Frame(index=k, image=image)).result, Spot)
            end = time.perf_counter()
            seconds[k] = end - start
            late += paced and end - due > 1 / _RATE_HZ
            if k % 30 == 0:
                memory.append(memory_mb())
        pace = "at 30 Hz" if paced else "as fast as it can"
        rows[pace] = _of_run(seconds, memory, lost=number - spots, late=late)
    return pd.DataFrame(rows).T


def tracking_load(full: bool = False) -> pd.DataFrame:
    """`eyespot track` of a folder of 320 x 240 px, a process of its own (full: 100,000 files).

    Each image has many names. The time of a frame contains the start.
    """
    number, frames = 100_000 if full else 3_000, _frames()
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
            memory = _memory(process, out.with_name("spots.partial.csv"))
        seconds = np.full(1, (time.perf_counter() - began) / number)
        with out.open("rb") as lines:
            lost = number - (sum(1 for _ in lines) - 1)
    return _of_run(seconds, memory, lost=lost).to_frame("track").T


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


def books(full: bool = False) -> pd.DataFrame:
    """A set's books by its stacks, copies of one small stack, so that rendering does not count."""
    rows = []
    for stacks in (1000, 3000, 10_000) if full else (1000, 3000):
        with tempfile.TemporaryDirectory() as folder:
            template, out = Path(folder) / "template", Path(folder) / "set"
            spec = load_spec("static-v1")
            scene = plan(spec)[0].scene
            scale = 10 * scene.microscope.scale_mm_px
            coarse = {"width_px": 64, "height_px": 48, "scale_mm_px": scale}
            render_stack(changed(scene, {"motion.frames": 1, "microscope": coarse}), template)
            spec = _sized(spec, stacks)
            began = time.perf_counter()
            planned = plan(spec)
            planning = time.perf_counter() - began
            none_of_them = stacks + 1, stacks + 1
            make_set(spec, out, workers=nullcontext(), shard=none_of_them)  # type: ignore[arg-type]
            for stack in planned:
                shutil.copytree(template, out / stack.split / stack.name)
            copied = time.perf_counter()
            make_set(spec, out, workers=nullcontext())  # type: ignore[arg-type]
            made = time.perf_counter()
            verify_set(out)
            verified = time.perf_counter()
        rows.append(
            {
                "stacks": stacks,
                "plan_ms_a_stack": 1e3 * planning / stacks,
                # Making the set plans it again.
                "card_and_manifest_ms_a_stack": 1e3 * (made - copied - planning) / stacks,
                "verify_ms_a_stack": 1e3 * (verified - made) / stacks,
                "peak_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3,
            }
        )
    return pd.DataFrame(rows).set_index("stacks")


def _sized(spec: SetSpec, count: int) -> SetSpec:
    """A spec of so many stacks, spread over the splits."""
    train = min(count, 4096)
    validation = min(count - train, 4096)
    numbers = {"train": train, "validation": validation, "test": count - train - validation}
    return spec.model_copy(update={"splits": spec.splits.model_copy(update=numbers)})


_TASKS, _IDLE_S, _FEW, _MORE = 2000, 20.0, 2, 8


def scheduler(full: bool = False) -> pd.DataFrame:
    """Processor time of the scheduler's thread; 200 workers are to cost it 5 % of a core.

    For tasks that do nothing, and for the heartbeats of few and of more workers.
    """
    planned = plan(_sized(load_spec("static-v1"), _TASKS))
    idle = []
    for workers in (_FEW, _MORE):
        with local_workers(workers) as client:
            client.wait_for_workers(workers)
            if workers == _FEW:
                _submitted(client, planned[:100])
                began = _thread_s(client)
                _submitted(client, planned)
                task_s = (_thread_s(client) - began) / len(planned)
            began = _thread_s(client)
            time.sleep(_IDLE_S)
            idle.append((_thread_s(client) - began) / _IDLE_S)
    heartbeat_s = (idle[1] - idle[0]) / (_MORE - _FEW) * heartbeat_interval(_MORE)
    return pd.DataFrame({"task_ms": [1e3 * task_s], "heartbeat_ms": [1e3 * heartbeat_s]})


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
