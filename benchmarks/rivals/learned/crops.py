"""Windows of a frame that the network gets: where they lie, their pixels, and the way back.

The first window comes from the brightest blurred blob of the frame. It is cheap and right to a
third of the spot's radius, which is enough: the network says where the ellipse lies in the window,
and a second window is cut around that.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Float

from estimator import FrameLabels, MicroscopeFile

CELLS = 64
"""Cells along a side of a window."""

REACH = 1.9
"""Half a window's side over the spot's mean radius: rim and surroundings are inside."""

_LEAST_HALF_PX = 24
_STRIDE = 8  # px of a cell in which the blob is searched
_BLUR_CELLS = 1.5
_LEAST_CONTRAST = 2.0  # grey values of a blob over the frame's median
_DARK = 1e-6


class Guess(NamedTuple):
    """A rough circle, px."""

    x: float
    y: float
    radius: float


class Window(NamedTuple):
    """A square of whole pixels: its left and upper edges and its side, px."""

    left: int
    top: int
    side: int

    @classmethod
    def around(cls, guess: Guess) -> Window:
        """The window for a spot of this place and mean radius."""
        half = max(REACH * guess.radius, _LEAST_HALF_PX)
        left, top = (round(at + 0.5 - half) for at in (guess.x, guess.y))
        return cls(left, top, round(2 * half))

    @property
    def half(self) -> float:
        """Half of the side, px."""
        return self.side / 2

    @property
    def centre(self) -> tuple[float, float]:
        """Centre in image coordinates, in which pixel centres are integers."""
        return self.left + self.half - 0.5, self.top + self.half - 0.5


def blob_in(image: np.ndarray) -> Guess | None:
    """The brightest blurred blob of an 8-bit frame; None in an even one."""
    grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY) if image.ndim == 3 else image
    height, width = (max(side // _STRIDE, 1) for side in grey.shape)
    coarse = cv2.resize(grey.astype(np.float32), (width, height), interpolation=cv2.INTER_AREA)
    coarse = cv2.GaussianBlur(coarse, (0, 0), _BLUR_CELLS)
    dark, bright = float(np.median(coarse)), float(coarse.max())
    if bright - dark < _LEAST_CONTRAST:
        return None
    above = (coarse > (dark + bright) / 2).astype(np.uint8)
    _, labels, stats, centres = cv2.connectedComponentsWithStats(above)
    label = labels[np.unravel_index(np.argmax(coarse), coarse.shape)]
    per_x, per_y = grey.shape[1] / width, grey.shape[0] / height
    x, y = centres[label]
    area = stats[label, cv2.CC_STAT_AREA] * per_x * per_y
    return Guess((x + 0.5) * per_x - 0.5, (y + 0.5) * per_y - 0.5, float(np.sqrt(area / np.pi)))


def cut(image: np.ndarray, window: Window) -> Float[np.ndarray, "3 64 64"]:
    """Pixels of a window: square roots of the grey values, where noise is even, from 0 to 1.

    What lies outside of the frame repeats its border. A grey frame counts as three equal channels.
    """
    colour = image if image.ndim == 3 else np.repeat(image[..., None], 3, axis=2)
    left, top, side = window
    rows, columns = (
        np.clip(np.arange(first, first + side), 0, size - 1)
        for first, size in zip((top, left), colour.shape[:2], strict=True)
    )
    inside = colour[np.ix_(rows, columns)]
    small = cv2.resize(inside.astype(np.float32), (CELLS, CELLS), interpolation=cv2.INTER_AREA)
    return np.sqrt(small / 255.0).transpose(2, 0, 1)


def evened(window: np.ndarray) -> np.ndarray:
    """A window with mean 0 and standard deviation 1 over all channels: exposure does not count."""
    values = np.asarray(window, np.float32)
    axes = (-3, -2, -1)
    spread = values.std(axis=axes, keepdims=True)
    return (values - values.mean(axis=axes, keepdims=True)) / np.maximum(spread, _DARK)


NUMBERS = ("x", "y", "size", "ratio_cos", "ratio_sin", "log_distance")
PLACES = 4
"""Numbers of `place_of`."""

_FIELD_MM, _HEIGHT_MM = 3.0, 200.0  # bring the place to the order of 1


def targets_of(labels: FrameLabels, window: Window) -> Float[np.ndarray, "6"]:
    """The true numbers of a window."""
    a, b = labels.half_max_semi_major_px, labels.half_max_semi_minor_px
    x, y = window.centre
    q, turn = math.log(a / b), 2 * labels.half_max_angle_rad
    return np.array(
        [
            (labels.half_max_x_px - x) / window.half,
            (labels.half_max_y_px - y) / window.half,
            math.log(REACH * math.sqrt(a * b) / window.half),
            q * math.cos(turn),
            q * math.sin(turn),
            math.log(labels.d_mm),
        ]
    )


def place_of(window: Window, microscope: MicroscopeFile) -> Float[np.ndarray, "4"]:
    """Where and how large a window is on the retina, and how high the pinhole is."""
    scale = microscope.scale_mm_px
    u, v = microscope.principal_point_px
    x, y = window.centre
    return np.array(
        [
            math.log(scale * window.half),
            scale * (x - u) / _FIELD_MM,
            scale * (y - v) / _FIELD_MM,
            microscope.pinhole_height_mm / _HEIGHT_MM,
        ]
    )


def ellipse_of(numbers: np.ndarray, window: Window) -> np.ndarray:
    """(x, y, semi-major, semi-minor, angle) in px and rad, of the first five numbers."""
    x, y = window.centre
    radius = window.half / REACH * math.exp(numbers[2])
    q = math.hypot(numbers[3], numbers[4])
    angle = math.atan2(numbers[4], numbers[3]) / 2
    return np.array(
        [
            x + window.half * numbers[0],
            y + window.half * numbers[1],
            radius * math.exp(q / 2),
            radius * math.exp(-q / 2),
            angle,
        ]
    )


def covariance_of(
    numbers: np.ndarray, sigmas: np.ndarray, window: Window
) -> Float[np.ndarray, "5 5"]:
    """Covariance of `ellipse_of`, px and rad, from independent errors of the numbers."""
    _, _, a, b, _ = ellipse_of(numbers, window)
    q = math.hypot(numbers[3], numbers[4])
    # Towards a circle the axes' direction is lost: there the ratio's error counts whichever way.
    along = np.array(numbers[3:5]) / q if q > 0 else np.array([1.0, 0.0])
    slopes = np.zeros((5, 5))
    slopes[0, 0] = slopes[1, 1] = window.half
    slopes[2, 2:] = a, *(a / 2 * along)
    slopes[3, 2:] = b, *(-b / 2 * along)
    floor = max(q, float(np.hypot(sigmas[3], sigmas[4])), 1e-9)
    slopes[4, 3:] = -along[1] / (2 * floor), along[0] / (2 * floor)
    return (slopes * np.square(sigmas[:5])) @ slopes.T
