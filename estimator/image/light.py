"""Converts frames into light: inverts the camera's response, and removes the wall's texture."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np

from estimator.image.frame import FULL_SCALE, Window, checked_frame
from optics import InputError

GREY = -1
"""Channel number of the weighted mean of red, green and blue."""

GREY_WEIGHTS = (0.299, 0.587, 0.114)
"""Weights of red, green and blue, as in cv2's RGB2GRAY."""

_SRGB_EXPONENT = 2.4
_BRIGHTEST = 1e6  # light over full scale; the squares of brighter light are no float32 numbers
_REFERENCE_BLUR_PX = 3.0  # removes noise from the reference frame, and keeps the wall's texture
_DARKEST_REFERENCE = 0.2  # of its median; darker pixels are a shaft, not the wall


@dataclass(frozen=True, kw_only=True)
class Response:
    """Relation of a frame's values to light.

    Attributes:
        curve: "linear", "srgb" (IEC 61966-2-1) or "gamma" (value = light ** (1 / gamma)).
        gamma: exponent of the curve "gamma".
        full_scale: value of the brightest light that the camera measures, such as 4095 of 12 bits
            in uint16; by default the largest of an unsigned dtype, 1 for floats. Frames that were
            shifted to the upper bits, or reduced to 8 bits, end at what corresponds to it. Spots
            may be clipped below it, see `clip_level`.
    """

    curve: Literal["linear", "srgb", "gamma"] = "linear"
    gamma: float = 2.2
    full_scale: float | None = None

    def __post_init__(self) -> None:
        """Reject curves that cannot be inverted."""
        if self.curve not in ("linear", "srgb", "gamma"):
            raise InputError(
                f"Response(curve=...) must be 'linear', 'srgb' or 'gamma'; got {self.curve!r}."
            )
        if not 0 < self.gamma < float("inf"):
            raise InputError(f"Response(gamma=...) must be positive; got {self.gamma}.")
        if self.full_scale is not None and not 0 < self.full_scale < float("inf"):
            raise InputError(f"Response(full_scale=...) must be positive; got {self.full_scale}.")

    def full_scale_of(self, frame: np.ndarray) -> float:
        """Value of the brightest light in a frame of this kind.

        Raises:
            InputError: the frame has brighter values, or it does not show what the curve needs.
        """
        container = FULL_SCALE[frame.dtype.type]
        if frame.dtype == np.uint8:
            return min(self.full_scale or container, container)
        if self.full_scale is None and (self.curve == "linear" or frame.dtype.kind == "f"):
            return container
        most = float(frame.max())
        if self.full_scale is not None and (most <= self.full_scale or frame.dtype.kind == "f"):
            return self.full_scale
        if self.full_scale is None and most >= container / 2:
            return container
        # The lowest bits of values that were shifted up are 0.
        used = int(np.bitwise_or.reduce(frame, axis=None))
        shift = (used & -used).bit_length() - 1 if used else 0
        if shift and most >= container / 2:
            return container + 1 - (1 << shift)
        if self.full_scale is None:
            raise InputError(
                f"the full scale of 16-bit images with the curve {self.curve} is not known; the "
                f"largest value is {most:g}. Give full_scale (--full-scale 4095 for 12 bits), or "
                "write it into the microscope file."
            )
        raise InputError(
            f"full_scale (or camera.bit_depth of the microscope file) is {self.full_scale:g}, but "
            f"the image has values up to {most:g}. Correct it, or give another --full-scale."
        )

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
        # Floats may exceed full scale, but not grow without limit.
        exponent = self.gamma if self.curve == "gamma" else _SRGB_EXPONENT
        fraction = np.clip(fraction, np.float32(0), np.float32(_BRIGHTEST ** (1 / exponent)))
        if self.curve == "gamma":
            return fraction ** np.float32(self.gamma)
        above = ((fraction + np.float32(0.055)) / np.float32(1.055)) ** np.float32(_SRGB_EXPONENT)
        return np.where(fraction <= 0.04045, fraction / np.float32(12.92), above)


class LightMeter:
    """Converts parts of frames into light; with a reference frame, as if the wall were even."""

    def __init__(self, response: Response, reference: np.ndarray | None) -> None:
        self.response = response
        self._reference = None if reference is None else checked_frame(reference)
        self._walls: dict[int, np.ndarray] = {}

    def check(self, frame: np.ndarray) -> None:
        """Refuse frames that do not fit the reference.

        Raises:
            InputError: the reference frame has another shape.
        """
        if self._reference is not None and self._reference.shape != frame.shape:
            raise InputError(
                "SubpixelSettings(reference=...) must have the frames' shape;"
                f" got {self._reference.shape}, frame {frame.shape}."
            )

    def light(
        self, values: np.ndarray, window: Window, channel: int, full_scale: float, stride: int = 1
    ) -> np.ndarray:
        """Light of one channel, or of the grey mean, as float32 in units of the frame's values.

        Args:
            values: the window's, `window.of(frame, stride)`.
            window: their place in a checked frame.
            channel: 0, 1, 2 or GREY.
            full_scale: of the frame.
            stride: px of the frame per value.
        """
        light = self._channel(values, channel, full_scale)
        if self._reference is None:
            return light
        return light / window.of(self._wall(self._reference, channel), stride)

    def ceiling(
        self, window: Window, channel: int, clips: tuple[float, ...], full_scale: float
    ) -> float:
        """Light at which pixels are clipped where the wall is brightest.

        Args:
            window: of a checked frame.
            channel: 0, 1, 2 or GREY.
            clips: value at which each channel is clipped.
            full_scale: of the frame.
        """
        light = self.response.light(np.array(clips, np.float32), full_scale).tolist()
        grey = (
            sum(w * c for w, c in zip(GREY_WEIGHTS, light, strict=True)) if light[1:] else light[0]
        )
        brightest = grey if channel == GREY else light[channel]
        if self._reference is None:
            return float(brightest)
        return float(brightest / window.of(self._wall(self._reference, channel)).max())

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
