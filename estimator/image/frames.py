"""Frames as light: what is accepted, through which response, over which wall."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np

GREY = -1
"""Channel number of the weighted mean of red, green and blue."""

GREY_WEIGHTS = (0.299, 0.587, 0.114)
"""Of red, green and blue in cv2's RGB2GRAY."""

_FULL_SCALE = {np.uint8: 255.0, np.uint16: 65535.0, np.float32: 1.0, np.float64: 1.0}
_REFERENCE_BLUR_PX = 3.0  # of the reference frame: its noise, not the wall's texture, goes
_DARKEST_REFERENCE = 0.2  # of its median: a shaft in the reference frame is no wall


@dataclass(frozen=True, kw_only=True)
class Response:
    """How a frame's values follow from light.

    Attributes:
        curve: "linear", "srgb" (IEC 61966-2-1) or "gamma" (value = light ** (1 / gamma)).
        gamma: exponent of the curve "gamma".
        full_scale: value at which a pixel saturates; by default the largest of an unsigned dtype,
            1 for floats. A 12-bit camera in uint16 needs 4095.
    """

    curve: Literal["linear", "srgb", "gamma"] = "linear"
    gamma: float = 2.2
    full_scale: float | None = None

    def __post_init__(self) -> None:
        """Reject curves that cannot be inverted."""
        if self.curve not in ("linear", "srgb", "gamma"):
            raise ValueError(
                f"Response(curve=...) must be 'linear', 'srgb' or 'gamma'; got {self.curve!r}."
            )
        if not 0 < self.gamma < float("inf"):
            raise ValueError(f"Response(gamma=...) must be positive; got {self.gamma}.")
        if self.full_scale is not None and not 0 < self.full_scale < float("inf"):
            raise ValueError(f"Response(full_scale=...) must be positive; got {self.full_scale}.")

    def full_scale_of(self, frame: np.ndarray) -> float:
        """Value at which the frame's pixels saturate."""
        return self.full_scale or _FULL_SCALE[frame.dtype.type]

    def light(self, values: np.ndarray, full_scale: float) -> np.ndarray:
        """Invert the curve: float32 light in units in which full scale is `full_scale`."""
        if self.curve == "linear":
            return values.astype(np.float32)
        if values.dtype == np.uint8:
            table = self._inverted(np.arange(256, dtype=np.float32) / np.float32(full_scale))
            return cv2.LUT(values, table * np.float32(full_scale))
        fraction = values.astype(np.float32) / np.float32(full_scale)
        return self._inverted(fraction) * np.float32(full_scale)

    def _inverted(self, fraction: np.ndarray) -> np.ndarray:
        fraction = np.maximum(fraction, np.float32(0))
        if self.curve == "gamma":
            return fraction ** np.float32(self.gamma)
        above = ((fraction + np.float32(0.055)) / np.float32(1.055)) ** np.float32(2.4)
        return np.where(fraction <= 0.04045, fraction / np.float32(12.92), above)


def checked_frame(frame: np.ndarray) -> np.ndarray:
    """A frame as (H, W) or (H, W, 3) in native byte order.

    Raises:
        ValueError: not an array of uint8, uint16, float32 or float64, not grey or RGB, empty, or
            not finite.
    """
    if not isinstance(frame, np.ndarray):
        raise ValueError(f"A frame must be a NumPy array; got {type(frame).__name__}.")
    if frame.dtype.type not in _FULL_SCALE:
        raise ValueError(
            f"A frame must be uint8, uint16, float32 or float64; got {frame.dtype.name}."
            " Convert it with astype, and give Response(full_scale=...) if its range differs."
        )
    if frame.ndim == 3 and frame.shape[2] == 1:
        frame = frame[:, :, 0]
    if frame.ndim not in (2, 3) or (frame.ndim == 3 and frame.shape[2] != 3):
        raise ValueError(
            f"A frame must have shape (H, W) or (H, W, 3), RGB; got {frame.shape}."
            " Drop an alpha channel with frame[:, :, :3]."
        )
    if frame.size == 0:
        raise ValueError(f"A frame must have pixels; got shape {frame.shape}.")
    if frame.dtype.kind == "f" and not np.abs(frame).max() < 1e12:
        raise ValueError(
            "A frame must be finite (and below 1e12); got NaN, infinity or more."
            " Replace such pixels before measuring."
        )
    if not frame.dtype.isnative:
        frame = frame.astype(frame.dtype.newbyteorder("="))
    return frame


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


class LightMeter:
    """Turns parts of frames into light, as if the wall were even where a reference shows it."""

    def __init__(self, response: Response, reference: np.ndarray | None) -> None:
        self.response = response
        self._reference = None if reference is None else checked_frame(reference)
        self._walls: dict[int, np.ndarray] = {}

    def check(self, frame: np.ndarray) -> None:
        """Refuse frames that the reference does not fit.

        Raises:
            ValueError: the reference frame has another shape.
        """
        if self._reference is not None and self._reference.shape != frame.shape:
            raise ValueError(
                "SubpixelSettings(reference=...) must have the frames' shape;"
                f" got {self._reference.shape}, frame {frame.shape}."
            )

    def light(
        self, values: np.ndarray, window: Window, channel: int, full_scale: float, stride: int = 1
    ) -> np.ndarray:
        """Light of one channel, or of the grey mean, as float32 in units of the frame's values.

        Args:
            values: of the window, `window.of(frame, stride)`.
            window: where in a checked frame they are.
            channel: 0, 1, 2 or GREY.
            full_scale: of the frame.
            stride: px of the frame per value.
        """
        light = self._channel(values, channel, full_scale)
        if self._reference is None:
            return light
        return light / window.of(self._wall(self._reference, channel), stride)

    def ceiling(self, window: Window, channel: int, full_scale: float) -> float:
        """Light at full scale, where the wall is brightest."""
        if self._reference is None:
            return full_scale
        return full_scale / float(window.of(self._wall(self._reference, channel)).max())

    def _channel(self, values: np.ndarray, channel: int, full_scale: float) -> np.ndarray:
        if values.ndim == 2:
            return self.response.light(values, full_scale)
        if channel != GREY:
            return self.response.light(cv2.extractChannel(values, channel), full_scale)
        if self.response.curve == "linear":
            return _grey(values).astype(np.float32)
        return _grey(self.response.light(values, full_scale))

    def _wall(self, reference: np.ndarray, channel: int) -> np.ndarray:
        if channel not in self._walls:
            full_scale = self.response.full_scale_of(reference)
            light = self._channel(reference, channel, full_scale)
            smooth = cv2.GaussianBlur(light, (0, 0), _REFERENCE_BLUR_PX)
            typical = max(float(np.median(smooth)), 1e-6 * full_scale)
            even = np.maximum(smooth / np.float32(typical), np.float32(_DARKEST_REFERENCE))
            self._walls[channel] = even
        return self._walls[channel]


def _grey(values: np.ndarray) -> np.ndarray:
    if values.dtype == np.float64:
        values = values.astype(np.float32)
    return cv2.cvtColor(values, cv2.COLOR_RGB2GRAY)
