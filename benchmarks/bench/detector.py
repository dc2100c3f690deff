"""Time of a frame in sub-pixel and literal mode."""

from __future__ import annotations

import time

import cv2
import numpy as np

from benchmarks.bench import tracks
from estimator import LiteralSettings, SubpixelSettings, TrackState, measure
from scenes.drawn import SHAPE, Drawing, Truth, any_wall, frame_of

_WARM, _FRAMES = 20, 400
_JUMP_EVERY = 50  # frames; a jump loses the spot, which is then found again
_JUMP_PX = 150.0
_STEPS_PX = [(1.6 * k, 1.2 * k) for k in range(6)]  # 2 px per frame, there and back
_MODES: tuple[SubpixelSettings | LiteralSettings, ...] = (
    SubpixelSettings(),
    LiteralSettings(threshold=90),
)  # these frames are darker than the paper


@tracks(
    subpixel_median_ms=lambda speed, *_: float(speed.median[0]),
    subpixel_99_percent_ms=lambda speed, *_: float(speed.late[0]),
    literal_median_ms=lambda speed, *_: float(speed.median[1]),
    literal_over_subpixel=lambda speed, *_: float(speed.median[1] / speed.median[0]),
)
class Speed:
    """A spot that moves slowly and jumps out of the search region every 50 frames; one thread."""

    params = ([SHAPE, (1080, 1920)], ["even", "retina"])
    param_names = ("shape", "wall")
    full = False

    def setup(self, shape: tuple[int, int], wall: str) -> None:
        """Measure; the modes alternate frame by frame, so that other work affects both equally."""
        cv2.setNumThreads(1)
        rng = np.random.default_rng(0)
        texture = any_wall(rng, shape) if wall == "retina" else None
        here = Truth(x=230, y=230, semi_major=66, semi_minor=60, angle=0.5)
        ways = []
        for start in (here, here.moved(_JUMP_PX, 0)):
            drawings = [Drawing(truth=start.moved(*step), wall=texture) for step in _STEPS_PX]
            frames = [frame_of(drawing, rng, shape) for drawing in drawings]
            ways.append(frames + frames[-2:0:-1])
        states = [TrackState(at_px=(230, 230)), TrackState(at_px=(230, 230))]
        seconds = []
        for k in range(_WARM + _FRAMES * (10 if self.full else 1)):
            way = ways[k // _JUMP_EVERY % 2]
            for mode, settings in enumerate(_MODES):
                began = time.perf_counter()
                _, states[mode] = measure(way[k % len(way)], states[mode], settings)
                seconds.append(time.perf_counter() - began)
        ms = 1e3 * np.reshape(seconds, (-1, 2))[_WARM:]
        self.median, self.late = np.median(ms, axis=0), np.percentile(ms, 99, axis=0)
