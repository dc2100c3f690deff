"""How much noise a camera's pixels have in known light: shot and read noise, rounding, JPEG."""

from __future__ import annotations

import functools
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from eyespot.formats.camera_sheet import VIDEO_BLACK, VIDEO_WHITE, CameraSheet, Response
from eyespot.formats.microscope import MicroscopeFile

if TYPE_CHECKING:
    from jaxtyping import Bool, Float  # 0.1 s, a tenth of a short `track`

_JPEG_DN2 = 2.5**2 / 12
"""At quality 90 the waves of a block are rounded to steps of 2 to 3 DN, in all channels alike: a
mean over them is no better than one."""
_CLEAR_SIGMAS = 4.0  # least distance of a pixel from black and white, where noise is clipped
_BAYER = 10.0 / 3.0
"""Growth of the variance of a mean over many pixels by a Bayer filter: a mean of three independent
channels has 3 variances of 9, one of a filtered camera's 4 + 2 + 4, as it has read a quarter, half
and a quarter of the pixels."""
_BAYER_CUT = 0.5
"""`CameraNoise.cut` with a Bayer filter. Edges at random places and angles leave 0.3 of the step in
a demosaiced red or blue image and 0.14 in a green one, and 0.5 in a mixture like 1.8 red - 0.9
green, in which a retina is even."""
USUAL_CUT = 0.01
"""`CameraNoise.cut` of other cameras: in rendered cells of known pose the likeliest value was 0 to
0.015, by wall."""


@dataclass(frozen=True, eq=False)
class CameraNoise:
    """A camera's noise after EMVA 1288, in full wells, from its sheet and its response curve.

    Attributes:
        channel_count: channels of its images, 3 or 1.
    """

    sheet: CameraSheet
    response: Response
    channel_count: int = 3

    def for_image(self, image: np.ndarray) -> CameraNoise:
        """The noise of images, H x W or H x W x 3, like this one."""
        return replace(self, channel_count=1 if image.ndim == 2 else image.shape[2])

    @functools.cached_property
    def full_scale(self) -> int:
        """Largest value of a pixel, DN."""
        return self.sheet.full_scale

    @functools.cached_property
    def black(self) -> float:
        """Level of a dark pixel, as a fraction of full scale."""
        return self.sheet.black_level_dn / self.sheet.full_scale

    @property
    def cut(self) -> float:
        """Error of a pixel that an edge cuts, over the step: no pixel is seen evenly."""
        return _BAYER_CUT if self.sheet.bayer else USUAL_CUT

    def light(self, values: np.ndarray) -> Float[np.ndarray, "h w"]:
        """Mean light of an image's channels; with noise it can be negative."""
        return self.channels(values).mean(axis=-1, dtype=float)

    def channels(self, values: np.ndarray) -> Float[np.ndarray, "h w c"]:
        """Light of an image's channels, c = 1 if it is H x W; with noise it can be negative."""
        values = values[..., None] if values.ndim == 2 else values
        dark = self.sheet.dark_signal_e / self.sheet.full_well_e
        return (self._straight(values) - self.black) / (1 - self.black) - dark

    def is_within(self, values: np.ndarray) -> Bool[np.ndarray, "h w"]:
        """Whether a pixel is neither black nor at full scale in any channel."""
        low, high = (0.0, 1.0) if not self.response.limited else (VIDEO_BLACK, VIDEO_WHITE)
        inside = (values > low * self.full_scale) & (values < high * self.full_scale)
        return inside if inside.ndim == 2 else np.all(inside, axis=-1)

    def variance(self, light: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
        """Variance of the mean over channels for known light, see `channel_variance`."""
        return self.channel_variance(light) / self.channel_count

    def channel_variance(self, light: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
        """Variance of a channel for known light: shot noise, read noise and rounding.

        Pixel values are rounded after the response curve, so the inverse curve gives the step in
        light.
        """
        own = self.sheet
        electrons = np.maximum(light, 0) * own.full_well_e + own.dark_signal_e
        still = own.read_noise_e**2 + own.dsnu_e**2 + (own.prnu * electrons) ** 2
        counted = (electrons + still) / own.full_well_e**2
        step = np.interp(self._level(light), *self._steps) / (1 - self.black)
        rounded = step**2 / 12
        if own.jpeg:
            rounded = rounded + self.channel_count * _JPEG_DN2 * step**2
        return (_BAYER if own.bayer else 1.0) * (counted + rounded)

    def mixture_variance(
        self,
        weights: Float[np.ndarray, "c"],
        shares: Float[np.ndarray, "c"],
        light: Float[np.ndarray, "*n"],
    ) -> Float[np.ndarray, "*n"]:
        """Variance of the weighted sum of channels, each of which has a share of some light."""
        of_channels = self.channel_variance(np.multiply.outer(shares, light))
        return np.tensordot(weights**2, of_channels, 1)

    def is_clear(self, light: Float[np.ndarray, "*n"]) -> Bool[np.ndarray, "*n"]:
        """Whether a pixel with this light stays between black and white in spite of noise."""
        reach = _CLEAR_SIGMAS * np.sqrt(self.channel_variance(light))
        level = self._level(light)
        return (level > reach) & (level < 1 - reach)

    @functools.cached_property
    def _steps(self) -> tuple[np.ndarray, np.ndarray]:
        """Light of each pixel value before the response curve, and the step to the next one."""
        levels = np.arange(self.full_scale + 1).astype(np.min_scalar_type(self.full_scale))
        straight = self._straight(levels)
        return straight, np.gradient(straight)

    def _level(self, light: np.ndarray) -> np.ndarray:
        dark = self.sheet.dark_signal_e / self.sheet.full_well_e
        return self.black + (1 - self.black) * (light + dark)

    def _straight(self, values: np.ndarray) -> np.ndarray:
        """Pixel values before the response curve, as fractions of full scale."""
        light = self.response.light(values, float(self.full_scale))
        return light.astype(float) / self.full_scale


def camera_noise(view: MicroscopeFile) -> CameraNoise | None:
    """The noise of a microscope's camera; None if it was not measured."""
    return None if view.noise is None else CameraNoise(view.noise, view.response)
