"""A camera's temporal noise after EMVA 1288."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from estimator.image.light import Response
from optics import InputError

_CHANNELS = 3
_JPEG_DN2 = _CHANNELS * 2.5**2 / 12
"""At quality 90 the waves of a block are rounded to steps of 2 to 3 DN, in all channels alike: a
mean over them is no better than one."""
_CLEAR_SIGMAS = 4.0  # least distance of a pixel from black and white, where noise is clipped


@dataclass(frozen=True, kw_only=True, eq=False)
class CameraNoise:
    """A camera's temporal noise after EMVA 1288, in full wells.

    Attributes:
        full_well_e: electrons at full scale.
        read_noise_e: standard deviation of a dark pixel, electrons.
        dark_signal_e: mean thermal electrons.
        black: level of a dark pixel, as a fraction of full scale.
        full_scale: largest pixel value in a file.
        response: response curve of the pixel values.
        prnu: standard deviation of the pixels' gain, relative.
        dsnu_e: standard deviation of the pixels' dark signal, electrons.
        cut: error of a pixel that an edge cuts, over the step; no camera sees all of a pixel alike.
            In rendered cells of known pose the likeliest value was 0 to 0.015, by wall.
        correlated: growth of the variance of a mean over many pixels, whose noise is correlated.
        coarse_colours: whether only the sum of the channels is true to the light, as after JPEG.
    """

    full_well_e: float
    read_noise_e: float
    dark_signal_e: float
    black: float
    full_scale: int
    response: Response
    prnu: float = 0.0
    dsnu_e: float = 0.0
    cut: float = 0.01
    correlated: float = 1.0
    coarse_colours: bool = False

    @classmethod
    def of(cls, camera: dict[str, Any], response: Response) -> CameraNoise:
        """Read the table [camera] of the scene.

        Raises:
            InputError: the camera correlates the noise of pixels or has fixed-pattern noise.
        """
        unsupported = {
            "bayer": camera["bayer"] != "none",
            "jpeg_quality": camera["jpeg_quality"] > 0,
            "prnu": camera["prnu"] > 0,
            "dsnu_e": camera["dsnu_e"] > 0,
        }
        if any(unsupported.values()):
            names = ", ".join(f"{name} = {camera[name]}" for name, on in unsupported.items() if on)
            raise InputError(
                f"the image fit needs independent noise in every pixel; this camera has {names}. "
                "Record raw frames, divided by a flat field, or fit the spots (--model cone)."
            )
        full_scale = (1 << camera["bit_depth"]) - 1
        return cls(
            full_well_e=camera["full_well_e"],
            read_noise_e=camera["read_noise_e"],
            dark_signal_e=camera["dark_signal_e"],
            black=camera["black_level_dn"] / full_scale,
            full_scale=full_scale,
            response=response,
        )

    def light(self, values: np.ndarray) -> Float[np.ndarray, "h w"]:
        """Mean light of an image's channels; with noise it can be negative."""
        return self.channels(values).mean(axis=-1, dtype=float)

    def channels(self, values: np.ndarray) -> Float[np.ndarray, "h w 3"]:
        """Light of an image's channels; with noise it can be negative."""
        dark = self.dark_signal_e / self.full_well_e
        return (self._straight(values) - self.black) / (1 - self.black) - dark

    def variance(self, light: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
        """Variance of the mean over channels for known light, see `channel_variance`."""
        return self.channel_variance(light) / _CHANNELS

    def channel_variance(self, light: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
        """Variance of a channel for known light: shot noise, read noise and rounding.

        Pixel values are rounded after the response curve, so the inverse curve gives the step in
        light.
        """
        electrons = np.maximum(light, 0) * self.full_well_e + self.dark_signal_e
        still = self.read_noise_e**2 + self.dsnu_e**2 + (self.prnu * electrons) ** 2
        counted = (electrons + still) / self.full_well_e**2
        step = np.interp(self._level(light), *self._steps) / (1 - self.black)
        rounded = step**2 / 12
        if self.coarse_colours:
            rounded = rounded + _JPEG_DN2 * step**2
        return self.correlated * (counted + rounded)

    def is_clear(self, light: Float[np.ndarray, "*n"]) -> Bool[np.ndarray, "*n"]:
        """Whether a pixel with this light stays between black and white in spite of noise."""
        reach = _CLEAR_SIGMAS * np.sqrt(_CHANNELS * self.variance(light))
        level = self._level(light)
        return (level > reach) & (level < 1 - reach)

    @functools.cached_property
    def _steps(self) -> tuple[np.ndarray, np.ndarray]:
        """Light of each pixel value before the response curve, and the step to the next one."""
        levels = np.arange(self.full_scale + 1).astype(np.min_scalar_type(self.full_scale))
        straight = self._straight(levels)
        return straight, np.gradient(straight)

    def _level(self, light: np.ndarray) -> np.ndarray:
        return self.black + (1 - self.black) * (light + self.dark_signal_e / self.full_well_e)

    def _straight(self, values: np.ndarray) -> np.ndarray:
        """Pixel values before the response curve, as fractions of full scale."""
        light = self.response.light(values, float(self.full_scale))
        return light.astype(float) / self.full_scale
