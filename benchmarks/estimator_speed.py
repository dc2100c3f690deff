"""Time of a frame, both modes on the same frames in the same run."""

from __future__ import annotations

import time
from typing import NamedTuple

import numpy as np

from benchmarks.estimator_frames import SHAPE, Scene, Truth, any_wall, frame_of
from estimator import LiteralSettings, SubpixelSettings, TrackState, measure

_WARM = 20
_JUMP_EVERY = 50  # frames; a jump is a loss, and what follows a recovery
_JUMP_PX = 150.0
_THRESHOLD = 90  # of the literal mode: these frames are not as bright as the paper's


class Times(NamedTuple):
    """Seconds a frame."""

    frames: str
    subpixel: np.ndarray
    literal: np.ndarray


def frame_times(number: int) -> list[Times]:
    """Times of a spot that stays and now and then jumps further than it may.

    The modes take turns frame by frame, so that both meet the machine in the same state.
    """
    rng = np.random.default_rng(0)
    measured = []
    for shape in (SHAPE, (1080, 1920)):
        for name, walled in (("even", False), ("retina", True)):
            wall = any_wall(rng, shape) if walled else None
            here = Truth(x=230, y=230, semi_major=66, semi_minor=60, angle=0.5)
            there = here.moved(_JUMP_PX, 0)
            images = [frame_of(Scene(truth=t, wall=wall), rng, shape) for t in (here, there)]
            seconds = _timed(images, number)
            measured.append(Times(f"{shape[1]} x {shape[0]}, {name}", *seconds))
    return measured


def _timed(images: list[np.ndarray], number: int) -> tuple[np.ndarray, np.ndarray]:
    modes: tuple[SubpixelSettings | LiteralSettings, ...] = (
        SubpixelSettings(),
        LiteralSettings(threshold=_THRESHOLD),
    )
    states = [TrackState(at_px=(230, 230)), TrackState(at_px=(230, 230))]
    seconds: tuple[list[float], list[float]] = [], []
    for k in range(_WARM + number):
        image = images[k // _JUMP_EVERY % 2]
        for mode, settings in enumerate(modes):
            began = time.perf_counter()
            _, states[mode] = measure(image, states[mode], settings)
            seconds[mode].append(time.perf_counter() - began)
    return np.array(seconds[0][_WARM:]), np.array(seconds[1][_WARM:])
