"""What a camera's values mean: response, data sheet, distortion."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

import cv2
import numpy as np
from pydantic import Field

from eyespot.formats.inputs import InputError, Strict

FULL_SCALE = {np.uint8: 255.0, np.uint16: 65535.0, np.float32: 1.0, np.float64: 1.0}
"""Types of a frame's values, and the value at which they saturate by default."""

GREY = -1
"""Channel number of the weighted mean of red, green and blue."""

GREY_WEIGHTS = (0.299, 0.587, 0.114)
"""Weights of red, green and blue, as in cv2's RGB2GRAY."""

VIDEO_BLACK, VIDEO_WHITE = 16 / 255, 235 / 255
"""Black and white of video, as fractions of full scale (ITU-R BT.601)."""
_MAX_LIGHT = 1e6  # light over full scale; the squares of brighter light are no float32 numbers


def light_of_srgb(value: np.ndarray) -> np.ndarray:
    """Light of a value in sRGB (IEC 61966-2-1), both as fractions of full scale."""
    return np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)


def srgb_of_light(light: np.ndarray) -> np.ndarray:
    """The inverse of `light_of_srgb`."""
    return np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)


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
        limited: whether black lies at 16/255 and white at 235/255 of full scale (ITU-R BT.601).
    """

    curve: Literal["linear", "srgb", "gamma"] = "linear"
    gamma: float = 2.2
    full_scale: float | None = None
    limited: bool = False

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
                f"largest value is {most:g}. State camera.full_scale of the rig file (4095 for 12 "
                "bits; --set camera.full_scale=4095)."
            )
        raise InputError(
            f"full_scale (or camera.bit_depth of the rig file) is {self.full_scale:g}, but "
            f"the image has values up to {most:g}. Correct it."
        )

    @property
    def is_straight(self) -> bool:
        """Whether values are light already."""
        return self.curve == "linear" and not self.limited

    def light(self, values: np.ndarray, full_scale: float) -> np.ndarray:
        """Invert the curve: float32 light in units in which full scale is `full_scale`."""
        if self.is_straight:
            return values.astype(np.float32)
        if values.dtype == np.uint8:
            table = self._inverted(np.arange(256, dtype=np.float32) / np.float32(full_scale))
            return cv2.LUT(values, table * np.float32(full_scale))
        fraction = values.astype(np.float32) / np.float32(full_scale)
        return self._inverted(fraction) * np.float32(full_scale)

    def _inverted(self, fraction: np.ndarray) -> np.ndarray:
        if self.limited:
            fraction = (fraction - np.float32(VIDEO_BLACK)) / np.float32(VIDEO_WHITE - VIDEO_BLACK)
        if self.curve == "linear":
            return fraction
        # Floats may exceed full scale, but not grow without limit.
        exponent = self.gamma if self.curve == "gamma" else 2.4
        fraction = np.clip(fraction, np.float32(0), np.float32(_MAX_LIGHT ** (1 / exponent)))
        return fraction**exponent if self.curve == "gamma" else light_of_srgb(fraction)

    def channel(self, values: np.ndarray, channel: int, full_scale: float) -> np.ndarray:
        """Light of one channel (0, 1, 2), or of the grey mean (GREY), as `light`."""
        if values.ndim == 2:
            return self.light(values, full_scale)
        if channel != GREY:
            return self.light(cv2.extractChannel(values, channel), full_scale)
        # A straight curve need not be inverted before the mean.
        straight = self.is_straight
        colours = values if straight else self.light(values, full_scale)
        if colours.dtype == np.float64:
            colours = colours.astype(np.float32)
        return cv2.cvtColor(colours, cv2.COLOR_RGB2GRAY).astype(np.float32, copy=False)

    def ceiling(self, channel: int, clips: tuple[float, ...], full_scale: float) -> float:
        """Light of a channel that is clipped, from the value at which each one is."""
        light = self.light(np.array(clips, np.float32), full_scale).tolist()
        if channel != GREY:
            return float(light[channel])
        return (
            sum(w * c for w, c in zip(GREY_WEIGHTS, light, strict=True)) if light[1:] else light[0]
        )


_NonNegative = Annotated[float, Field(ge=0, le=1e15)]


class CameraSheet(Strict):
    """A camera's temporal noise and fixed pattern."""

    full_well_e: float = Field(gt=0, le=1e15, description="Electrons at full scale.")
    read_noise_e: _NonNegative = Field(
        description="Temporal standard deviation of a dark pixel, electrons."
    )
    dark_signal_e: _NonNegative = Field(0.0, description="Mean thermal electrons.")
    black_level_dn: _NonNegative = Field(
        description="Mean of a dark image before the response curve, DN."
    )
    bit_depth: int = Field(ge=8, le=16, description="Bits per channel.")
    prnu: float = Field(
        0.0, ge=0, lt=1, description="Standard deviation of the pixels' gain, relative."
    )
    dsnu_e: _NonNegative = Field(
        0.0, description="Standard deviation of the pixels' dark signal, electrons."
    )
    bayer: bool = Field(
        False, description="Whether colours are interpolated between pixels of a Bayer filter."
    )
    jpeg: bool = Field(
        False, description="Whether the images were compressed, which leaves their colours coarse."
    )

    @property
    def full_scale(self) -> int:
        """Largest value of a pixel, DN."""
        return (1 << self.bit_depth) - 1


_UNDONE_PX = 1.0  # OpenCV's few iterations end within this where there is an inverse


@dataclass(frozen=True, kw_only=True, eq=False)
class LensDistortion:
    """Removes a lens's distortion from image points.

    Attributes:
        matrix: 3x3 camera matrix K, px; its focal lengths are negative if the pinhole, seen through
            the eye, lies behind the scene.
        distortion: 4, 5, 8, 12 or 14 coefficients in OpenCV's order; 4 of equidistant.
        model: brown is that of cv2.calibrateCamera; equidistant that of cv2.fisheye (Kannala and
            Brandt, 2006): r = f theta (1 + k1 theta^2 + ... + k4 theta^8) at the angle theta.
    """

    matrix: np.ndarray
    distortion: np.ndarray
    model: Literal["brown", "equidistant"] = "brown"

    def __post_init__(self) -> None:
        """Refuse matrices and coefficients that OpenCV cannot use."""
        matrix, distortion = np.asarray(self.matrix, float), np.asarray(self.distortion, float)
        if matrix.shape != (3, 3) or not np.isfinite(matrix).all() or matrix[0, 0] == 0:
            raise InputError(
                "camera_matrix must be a finite 3x3 matrix with focal lengths other than 0;"
                f" got shape {matrix.shape}. Calibrate the camera."
            )
        counts = (4,) if self.model == "equidistant" else (4, 5, 8, 12, 14)
        if distortion.size not in counts or not np.isfinite(distortion).all():
            raise InputError(
                f"the distortion must have {' or '.join(map(str, counts))} finite coefficients;"
                f" got {distortion.size}. Calibrate the camera."
            )
        object.__setattr__(self, "matrix", matrix)
        object.__setattr__(self, "distortion", distortion.ravel())

    def undistorted(self, points: np.ndarray) -> np.ndarray:
        """The points in the image of an ideal pinhole with the same matrix, (n, 2), px."""
        undistort = cv2.undistortPoints if self.model == "brown" else cv2.fisheye.undistortPoints
        return undistort(points.reshape(-1, 1, 2), self.matrix, self.distortion, P=self.matrix)[
            :, 0
        ]

    def can_undistort(self, points: np.ndarray) -> bool:
        """Whether the distortion has an inverse at points, (n, 2), px.

        A polynomial that was fitted to a part of the image turns back outside of it: several points
        of the ideal image are seen at one place, and OpenCV's iteration finds any or none of them.
        """
        back = self.all_distorted(self.undistorted(points))
        return bool(np.abs(back - points).max() < _UNDONE_PX)

    def all_distorted(self, points: np.ndarray) -> np.ndarray:
        """Points of the ideal image in this camera's image, (n, 2), px."""
        rays = np.linalg.solve(self.matrix, np.column_stack([points, np.ones(len(points))]).T)
        project = cv2.projectPoints if self.model == "brown" else cv2.fisheye.projectPoints
        rays = rays.T.reshape(-1, 1, 3)
        seen, _ = project(rays, np.zeros(3), np.zeros(3), self.matrix, self.distortion)
        return seen[:, 0]

    def distorted(self, x: float, y: float) -> tuple[float, float]:
        """A point of the ideal image in this camera's image, px."""
        u, v = self.all_distorted(np.array([[x, y]]))[0].tolist()
        return u, v
