"""Memory and time of a `Reader` in the mode pixels over many frames.

Frames of one hand's motion (`pixel_frames`) are read forwards and backwards again and again, so
that the motion has no jumps. Memory does not depend on other processes. Times do, so they are given
with the load of the machine.
"""

from __future__ import annotations

import os
import tempfile
import time
from itertools import cycle, islice
from pathlib import Path

import numpy as np

from benchmarks.bench.load import Memory
from benchmarks.bench.output import memory_mb, show, table
from benchmarks.bench.pixel_frames import (
    Circumstances,
    drawn_calibration,
    drawn_stack,
    prepare,
    robot_reader,
    told_poses,
)
from estimator.sources import open_source

_DISTINCT = 60
_LENGTHS = {False: 300, True: 10_000}  # frames, by `full`
_WARM = 2 * _DISTINCT - 2  # once forwards and backwards, while programs are compiled
_IN_TIME_S = 0.15
_WHAT = Circumstances("dome, vitreous", "photograph", "hand", _DISTINCT)


def run(*, full: bool) -> None:
    """Print memory, times and frames without a pose (`full`: 10,000 frames)."""
    prepare()
    rng, number = np.random.default_rng(20261126), _LENGTHS[full]
    seconds, memory, posed = np.empty(_WARM + number), [], 0
    with tempfile.TemporaryDirectory() as folder:
        stack = drawn_stack(_WHAT, rng, Path(folder) / "stack")
        frames = list(open_source(stack.folder))
        began = time.perf_counter()
        reader = robot_reader(stack, drawn_calibration(_WHAT, rng))
        start = time.perf_counter() - began
        poses = told_poses(stack, rng)
    camera = islice(cycle(frames + frames[-2:0:-1]), _WARM + number)
    for k, frame in enumerate(camera):
        began = time.perf_counter()
        read = reader.read(
            frame.image, time_s=frame.time_s, exposure_s=frame.exposure_s, poses=poses
        )
        seconds[k] = time.perf_counter() - began
        if k >= _WARM:
            posed += bool(read.range and read.range.poses)
            memory.append(memory_mb())
    warm, later = seconds[1:_WARM], seconds[_WARM:]
    rows = table(
        f"mode pixels, {_WHAT.beam}, {_WHAT.wall}, a hand's motion, 640x480 px",
        *("frames", "with a pose", "MB start", "middle", "end", "most", "start, s", "first, s"),
        *("ms, median", "99 %", "largest", f"within {1e3 * _IN_TIME_S:.0f} ms"),
        *("before: slower", "largest, s"),
        caption="start, first: the reader's and its first frame's time; before: of frames 2 to "
        f"{_WARM}, in which the wall's texture is learnt; the others are of later frames. Load of "
        f"the machine at the end: {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores",
    )
    rows.add_row(
        f"{number:,}",
        f"{posed:,}",
        *(f"{mb:.1f}" for mb in (*Memory.of(memory), max(memory))),
        f"{start:.1f}",
        f"{seconds[0]:.1f}",
        *(f"{1e3 * np.percentile(later, share):.0f}" for share in (50, 99, 100)),
        f"{100 * np.mean(later <= _IN_TIME_S):.1f} %",
        f"{np.count_nonzero(warm > _IN_TIME_S)}",
        f"{warm.max():.1f}",
    )
    show(rows, width=170)
