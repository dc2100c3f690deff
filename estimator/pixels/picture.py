"""The pixels of a frame: their light, and which of them show the wall."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float

from estimator.image import CameraNoise, Outline, clip_level
from estimator.pixels.cells import CellLight
from estimator.pixels.hidden import hidden_pixels
from estimator.pixels.mix import Mix, plain_mix
from estimator.pixels.wall_motion import STILL, WallMotion
from optics import InputError

_MIDDLE = 0.7  # half of the side of a square about the spot's middle, over its semi-minor axis
_LEAST_PX = 2.0  # of that


@dataclass(frozen=True, eq=False)
class Picture:
    """A frame's pixels.

    Attributes:
        noise: of the camera.
        channels: light, full wells.
        ends: light at which a channel is clipped.
        full: whether a channel is clipped.
        usable: whether a pixel shows the wall.
        saturated: whether a channel is at full scale in the spot, which has a sharp edge. The edge
            is seen nevertheless.
    """

    noise: CameraNoise
    channels: Float[np.ndarray, "h w 3"]
    ends: Float[np.ndarray, "3"]
    full: Bool[np.ndarray, "h w 3"]
    usable: Bool[np.ndarray, "h w"]
    saturated: Bool[np.ndarray, "3"]

    @classmethod
    def of(cls, image: np.ndarray, noise: CameraNoise) -> Picture:
        """All of an image, H x W x 3.

        Raises:
            InputError: it is brighter than the camera can be.
        """
        if image.max() > noise.full_scale:
            raise InputError(
                f"the microscope file says that the camera's values end at {noise.full_scale}, but "
                f"the image has values up to {image.max():g}. Correct camera.bit_depth."
            )
        usable, saturated = np.ones(image.shape[:2], bool), np.zeros(3, bool)
        clips = [
            min(clip_level(values, values > values.max() // 2), noise.full_scale)
            for values in np.moveaxis(image, -1, 0)
        ]
        ends = noise.channels(np.array(clips, image.dtype))
        return cls(noise, noise.channels(image), ends, image >= clips, usable, saturated)

    def with_sharp(self, spot: Outline) -> Picture:
        """The frame without what hides a spot with a sharp edge, which may be saturated."""
        hidden = hidden_pixels(self.channels, spot)
        usable = self.usable if hidden is None else self.usable & ~hidden
        shown = replace(self, usable=usable)
        full = shown._in_middle(self.full, spot)
        return replace(shown, saturated=np.mean(full, axis=0) > 0.5) if full.size else shown

    def plain_mix(self, spot: Outline) -> Mix:
        """The luminance, for light of the spot's colour."""
        light = self._in_middle(self.channels, spot)
        return plain_mix(light.mean(axis=0) if light.size else np.ones(3), self.saturated)

    def cells(self, mix: Mix, motion: WallMotion = STILL) -> CellLight:
        """The light in a mixture of channels, after a motion of the wall."""
        mixed = mix.weights != 0
        saturated = bool(self.saturated[mixed].any())
        full = self.full[..., mixed].any(axis=-1)
        return CellLight(
            mix.light(self.channels),
            self.usable if saturated else self.usable & ~full,
            lambda light: mix.variance(self.noise, light),
            motion,
            float(mix.weights @ self.ends) if saturated else math.inf,
        )

    def _in_middle(self, pixels: np.ndarray, spot: Outline) -> np.ndarray:
        """Usable pixels about the middle of a spot, n x 3."""
        r = max(_MIDDLE * spot.semi_minor_px, _LEAST_PX)
        rows, columns = (
            slice(max(round(at - r), 0), max(round(at + r) + 1, 0)) for at in (spot.y_px, spot.x_px)
        )
        return pixels[rows, columns][self.usable[rows, columns]]
