"""Long measurements: `eyespot track` of many frames, and a `Reader` that keeps a camera's pace.

Memory and lost frames do not depend on other processes. Times do, so they are given with the load
of the machine.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from itertools import cycle, islice
from pathlib import Path
from typing import NamedTuple

import numpy as np
from rich.table import Table
from skimage.io import imsave

from benchmarks.bench.output import memory_mb, show, table
from estimator import Reader, Spot, SubpixelSettings
from scenes.drawn import Drawing, any_truth, any_wall, frame_of

_DISTINCT = 60  # drawn frames, which repeat
_RATE_HZ = 30.0
_WARM = 200  # frames before the memory of the start is taken
_LENGTHS = {False: (3_000, 3_000, 20.0), True: (100_000, 108_000, 300.0)}
"""By `full`: frames of `track`, frames of the reader, seconds at the camera's pace. 108,000 frames
are an hour at 30 Hz."""


class Memory(NamedTuple):
    """Resident memory of a process, MB: after the first frames, in the middle, and at the end."""

    start: float
    middle: float
    end: float

    @classmethod
    def of(cls, samples: list[float]) -> Memory:
        """From samples in the order of time."""
        return cls(samples[0], samples[len(samples) // 2], samples[-1])


def run(*, full: bool) -> None:
    """Print times, memory and lost frames (`full`: an hour of a camera, 100,000 files)."""
    tracked, read, seconds = _LENGTHS[full]
    frames = _frames()
    rows = table(
        "640x480 px in memory, 320x240 px as files",
        *("", "frames", "lost", "ms a frame", "slowest, ms", "MB start", "middle", "end"),
        caption=f"load of the machine at the end: {os.getloadavg()[0]:.1f} on {os.cpu_count()}"
        " cores",
    )
    _as_fast_as_possible(rows, frames, read)
    late = _at_pace(rows, frames, seconds)
    _track(rows, frames, tracked)
    show(rows, late)


def _frames() -> list[np.ndarray]:
    """A spot that moves round on a printed retina."""
    rng = np.random.default_rng(0)
    truth, wall = any_truth(rng, 60.0), any_wall(rng)
    turns = np.linspace(0, 2 * np.pi, _DISTINCT, endpoint=False)
    places = [truth.moved(60 * float(np.cos(t)), 60 * float(np.sin(t))) for t in turns]
    return [frame_of(Drawing(truth=place, wall=wall), rng) for place in places]


def _as_fast_as_possible(rows: Table, frames: list[np.ndarray], number: int) -> None:
    reader, seconds, memory, spots = Reader(SubpixelSettings()), np.empty(number), [], 0
    camera = cycle(frames)
    for image in islice(camera, _WARM):
        reader.read(image)
    for k, image in enumerate(islice(camera, number)):
        began = time.perf_counter()
        spots += isinstance(reader.read(image).result, Spot)
        seconds[k] = time.perf_counter() - began
        if k % 100 == 0:
            memory.append(memory_mb())
    _add(rows, "Reader, as fast as it can", number, number - spots, seconds, Memory.of(memory))


def _at_pace(rows: Table, frames: list[np.ndarray], seconds: float) -> str:
    """Read each frame when a camera would deliver it; none is skipped, but some may be late."""
    reader, number = Reader(SubpixelSettings()), round(seconds * _RATE_HZ)
    taken, memory, ready = np.empty(number), [], np.empty(number)
    camera = cycle(frames)
    for image in islice(camera, _WARM):
        reader.read(image)
    began = time.perf_counter()
    for k, image in enumerate(islice(camera, number)):
        due = began + k / _RATE_HZ
        time.sleep(max(due - time.perf_counter(), 0.0))
        start = time.perf_counter()
        reader.read(image)
        end = time.perf_counter()
        taken[k], ready[k] = end - start, end - due
        if k % 30 == 0:
            memory.append(memory_mb())
    late = int(np.count_nonzero(ready > 1 / _RATE_HZ))
    name = f"Reader, at {_RATE_HZ:.0f} Hz for {seconds:.0f} s"
    _add(rows, name, number, 0, taken, Memory.of(memory))
    return (
        f"at {_RATE_HZ:.0f} Hz a result is ready {1e3 * float(np.median(ready)):.1f} ms after its"
        f" frame (median; 99 %: {1e3 * float(np.percentile(ready, 99)):.1f} ms, at most"
        f" {1e3 * float(ready.max()):.1f} ms); {late} of {number:,} come after the next frame"
    )


def _track(rows: Table, frames: list[np.ndarray], number: int) -> None:
    """`eyespot track` of a folder, as a process of its own; each image has many names."""
    with tempfile.TemporaryDirectory() as temporary:
        folder, out = Path(temporary) / "frames", Path(temporary) / "spots.csv"
        folder.mkdir()
        for k, image in enumerate(frames):
            imsave(folder / f"{k:06d}.png", image[::2, ::2], check_contrast=False)
        for k in range(len(frames), number):
            os.link(folder / f"{k % len(frames):06d}.png", folder / f"{k:06d}.png")
        code = "import eyespot; eyespot.main()"
        command = [sys.executable, "-c", code, "track", str(folder), "--out", str(out), "--json"]
        began = time.perf_counter()
        with subprocess.Popen(command, stdout=subprocess.DEVNULL) as process:
            memory = list(_memory_of(process, out.with_name("spots.partial.csv")))
        seconds = time.perf_counter() - began
        with out.open("rb") as lines:
            lost = number - (sum(1 for _ in lines) - 1)
    taken = np.full(1, seconds / number)
    _add(rows, "eyespot track, with its start", number, lost, taken, Memory.of(memory))


def _memory_of(process: subprocess.Popen[bytes], lines: Path) -> Iterator[float]:
    """Memory of a process from its first hundred frames on, every quarter of a second."""
    while process.poll() is None:
        if lines.exists() and lines.stat().st_size > 50_000:
            try:
                yield memory_mb(process.pid)
            except (OSError, IndexError):  # it has just ended
                return
        time.sleep(0.25)


def _add(
    rows: Table, name: str, number: int, lost: int, seconds: np.ndarray, memory: Memory
) -> None:
    slowest = f"{1e3 * float(seconds.max()):.1f}" if seconds.size > 1 else ""
    times = (f"{1e3 * float(np.median(seconds)):.2f}", slowest)
    rows.add_row(name, f"{number:,}", str(lost), *times, *(f"{mb:.1f}" for mb in memory))
