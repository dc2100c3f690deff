"""Time per frame of both modes on the same frames."""

from __future__ import annotations

import time

import cv2
import numpy as np

from benchmarks.bench.output import show, table
from estimator import LiteralSettings, SubpixelSettings, TrackState, measure
from scenes.drawn import SHAPE, Drawing, Truth, any_wall, frame_of

_WARM, _FRAMES = 20, 400
_JUMP_EVERY = 50  # frames; a jump loses the spot, which is then found again
_JUMP_PX = 150.0
_STEPS_PX = [(1.6 * k, 1.2 * k) for k in range(6)]  # 2 px per frame, there and back
_THRESHOLD = 90  # of the literal mode; these frames are darker than the paper's


def run(*, full: bool) -> None:
    """Print the table for a spot that moves slowly and sometimes jumps out of the search region.

    The modes alternate frame by frame, so that other processes affect both equally.

    Args:
        full: ten times as many frames.
    """
    cv2.setNumThreads(1)
    number = _FRAMES * (10 if full else 1)
    made = table(
        "spot tracked, lost by a jump every 50 frames and found again; ms per frame, one thread",
        *("frames", "median", "99 %", "literal: median", "99 %", "literal / ours"),
    )
    rng = np.random.default_rng(0)
    for shape in (SHAPE, (1080, 1920)):
        for name, walled in (("even", False), ("retina", True)):
            wall = any_wall(rng, shape) if walled else None
            here = Truth(x=230, y=230, semi_major=66, semi_minor=60, angle=0.5)
            ways = [
                [
                    frame_of(Drawing(truth=start.moved(*step), wall=wall), rng, shape)
                    for step in _STEPS_PX
                ]
                for start in (here, here.moved(_JUMP_PX, 0))
            ]
            seconds = _timed([way + way[-2:0:-1] for way in ways], number)
            ours, literal = (1e3 * np.percentile(times, [50, 99]) for times in seconds)
            cells = (*ours, *literal, literal[0] / ours[0])
            made.add_row(f"{shape[1]} x {shape[0]}, {name}", *(f"{cell:.2f}" for cell in cells))
    show(made)


def _timed(ways: list[list[np.ndarray]], number: int) -> tuple[np.ndarray, np.ndarray]:
    modes: tuple[SubpixelSettings | LiteralSettings, ...] = (
        SubpixelSettings(),
        LiteralSettings(threshold=_THRESHOLD),
    )
    states = [TrackState(at_px=(230, 230)), TrackState(at_px=(230, 230))]
    seconds: tuple[list[float], list[float]] = [], []
    for k in range(_WARM + number):
        way = ways[k // _JUMP_EVERY % 2]
        image = way[k % len(way)]
        for mode, settings in enumerate(modes):
            began = time.perf_counter()
            _, states[mode] = measure(image, states[mode], settings)
            seconds[mode].append(time.perf_counter() - began)
    return np.array(seconds[0][_WARM:]), np.array(seconds[1][_WARM:])
