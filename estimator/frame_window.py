"""A frame as it is measured: checked, without a digital zoom's repeats, and windows of it."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from eyespot.formats.camera_sheet import FULL_SCALE
from eyespot.formats.inputs import InputError

_EXAMINED_ROWS = 8  # rows that are examined
_MIN_CHANGES = 64
"""Changes of value in these rows; all are at even places by chance in 2^-64 of frames."""
_MAX_REPEATS = 8  # largest factor of a digital zoom that repeats pixels


def checked_frame(frame: np.ndarray) -> np.ndarray:
    """A frame as (H, W) or (H, W, 3) in native byte order.

    Raises:
        InputError: not an array of uint8, uint16, float32 or float64, not grey or RGB, empty, or
            not finite.
    """
    if not isinstance(frame, np.ndarray):
        raise InputError(f"A frame must be a NumPy array; got {type(frame).__name__}.")
    if frame.dtype.type not in FULL_SCALE:
        raise InputError(
            f"A frame must be uint8, uint16, float32 or float64; got {frame.dtype.name}."
            " Convert it with astype, and give Response(full_scale=...) if its range differs."
        )
    if frame.ndim == 3 and frame.shape[2] == 1:
        frame = frame[:, :, 0]
    if frame.ndim not in (2, 3) or (frame.ndim == 3 and frame.shape[2] != 3):
        raise InputError(
            f"A frame must have shape (H, W) or (H, W, 3), RGB; got {frame.shape}."
            " Drop an alpha channel with frame[:, :, :3]."
        )
    if frame.size == 0:
        raise InputError(f"A frame must have pixels; got shape {frame.shape}.")
    if frame.dtype.kind == "f" and not np.abs(frame).max() < 1e12:
        raise InputError(
            "A frame must be finite (and below 1e12); got NaN, infinity or more."
            " Replace such pixels before measuring."
        )
    if not frame.dtype.isnative:
        frame = frame.astype(frame.dtype.newbyteorder("="))
    return frame


def without_repeats(frame: np.ndarray) -> np.ndarray:
    """A frame whose digital zoom, which repeats every pixel, is made one that interpolates.

    Args:
        frame: checked; returned unchanged if its pixels are not repeated 2 to 8 times either way.
    """
    plain = frame if frame.ndim == 2 else frame[..., 0]
    sides = [_repeats(plain), _repeats(plain.T)]
    if max(sides) < 2:
        return frame
    # A box as wide as a repeated pixel makes ramps of the steps. An even one has half a pixel at
    # either end, so that it is centred.
    x, y = (np.full(k, 1 / k) if k % 2 else np.r_[0.5, np.ones(k - 1), 0.5] / k for k in sides)
    return cv2.sepFilter2D(frame, -1, x, y, borderType=cv2.BORDER_REFLECT)


def _repeats(frame: np.ndarray) -> int:
    """How often each pixel of a row is repeated; 1 if not, or if too little is in the frame."""
    # One row usually suffices.
    for rows in frame[len(frame) // 2 :][:1], frame[:: max(len(frame) // _EXAMINED_ROWS, 1)]:
        changes = rows[:, 1:] != rows[:, :-1]
        places = np.flatnonzero(changes.any(axis=0))
        steps = int(np.gcd.reduce(places - places[:1], initial=0))
        if steps == 1:
            return 1
    return steps if steps <= _MAX_REPEATS and np.count_nonzero(changes) >= _MIN_CHANGES else 1


@dataclass(frozen=True)
class Window:
    """A rectangle of a frame, in whole pixels: columns x0 <= x < x1, rows y0 <= y < y1."""

    x0: int
    y0: int
    x1: int
    y1: int

    @classmethod
    def around(
        cls, x: float, y: float, half_width: float, half_height: float, frame: np.ndarray
    ) -> Window:
        """The part of the frame within the half sizes of a point; never empty."""
        height, width = frame.shape[:2]
        x0 = int(min(max(x - half_width, 0), width - 1))
        y0 = int(min(max(y - half_height, 0), height - 1))
        x1 = int(min(max(x + half_width + 1, x0 + 1), width))
        y1 = int(min(max(y + half_height + 1, y0 + 1), height))
        return cls(x0, y0, x1, y1)

    @classmethod
    def whole(cls, frame: np.ndarray) -> Window:
        """All of the frame."""
        return cls(0, 0, frame.shape[1], frame.shape[0])

    def on_grid(self, stride: int) -> Window:
        """The window from multiples of a stride on: all such windows subsample the same pixels."""
        return Window(self.x0 - self.x0 % stride, self.y0 - self.y0 % stride, self.x1, self.y1)

    def of(self, frame: np.ndarray, stride: int = 1) -> np.ndarray:
        """The window's pixels, or every n-th of them in either direction."""
        values = frame[self.y0 : self.y1, self.x0 : self.x1]
        height, width = values.shape[0] // stride, values.shape[1] // stride
        if stride == 1 or min(height, width) < 1 or values.dtype == np.float64:
            return values[::stride, ::stride]
        whole = values[: height * stride, : width * stride]
        # Four times as fast as a strided copy of colour pixels.
        return cv2.resize(whole, (width, height), interpolation=cv2.INTER_NEAREST)
