"""Where the view, the eyeball and the source's power are at a time."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from scenes.description import Scene

_LEAST_POWER = 1e-3
"""Of the mean: a swing of the power does not switch the source off."""


class Moment(NamedTuple):
    """What [unrest] moves, at one time.

    Attributes:
        view_px: shift of the image, x and y.
        turn: rotation vector of the eyeball around its centre, rad.
        power: of the source, relative to its mean.
    """

    view_px: np.ndarray
    turn: np.ndarray
    power: float


class UnrestPath:
    """What [unrest] moves, by frame and time.

    Args:
        scene: the scene.
        frames: number of frames.
    """

    def __init__(self, scene: Scene, *, frames: int) -> None:
        settings = scene.unrest
        shake, swing = (np.random.default_rng([settings.seed, own]) for own in (1, 2))
        self._shake = settings.shake_px * shake.standard_normal((frames, 2))
        self._power = np.maximum(
            1.0 + settings.power_swing * swing.standard_normal(frames), _LEAST_POWER
        )
        x, y = settings.drift_mm_s
        # Rows of an image run downwards.
        self._drift = np.array([x, -y]) / scene.microscope.scale_mm_px
        self._rate = np.array([math.radians(w) for w in settings.rotation_deg_s])

    def at(self, frame: int, time: float) -> Moment:
        """The state at a time of a frame's exposure, s."""
        view = self._shake[frame] + time * self._drift
        return Moment(view, time * self._rate, float(self._power[frame]))

    def views(self, times: np.ndarray) -> np.ndarray:
        """Shifts of the image at the middles of all frames' exposures, n x 2, px."""
        return self._shake + times[:, None] * self._drift
