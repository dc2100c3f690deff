"""The key `camera` of a microscope file: the camera's data sheet after EMVA 1288."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from estimator.image import CameraNoise, Response
from optics import Strict

_BAYER = 10.0 / 3.0
"""Growth of the variance of a mean over many pixels by a Bayer filter: a mean of three independent
channels has 3 variances of 9, one of a filtered camera's 4 + 2 + 4, as it has read a quarter, half
and a quarter of the pixels."""
_BAYER_CUT = 0.5
"""Error of a pixel that an edge cuts, over the step, with a Bayer filter. Edges at random places
and angles leave 0.3 of the step in a demosaiced red or blue image and 0.14 in a green one, and 0.5
in a mixture like 1.8 red - 0.9 green, in which a retina is even."""
_NonNegative = Annotated[float, Field(ge=0, le=1e15)]


class CameraSheet(Strict):
    """A camera's temporal noise and fixed pattern.

    Attributes:
        full_well_e: electrons at full scale.
        read_noise_e: temporal standard deviation of a dark pixel, electrons.
        dark_signal_e: mean thermal electrons.
        black_level_dn: mean of a dark image before the response curve, DN.
        bit_depth: bits per channel.
        prnu: standard deviation of the pixels' gain, relative.
        dsnu_e: standard deviation of the pixels' dark signal, electrons.
        bayer: whether colours are interpolated between the pixels of a Bayer filter.
        jpeg: whether the images were compressed, which leaves their colours coarse.
    """

    full_well_e: Annotated[float, Field(gt=0, le=1e15)]
    read_noise_e: _NonNegative
    dark_signal_e: _NonNegative = 0.0
    black_level_dn: _NonNegative
    bit_depth: Annotated[int, Field(ge=8, le=16)]
    prnu: Annotated[float, Field(ge=0, lt=1)] = 0.0
    dsnu_e: _NonNegative = 0.0
    bayer: bool = False
    jpeg: bool = False

    def noise(self, response: Response) -> CameraNoise:
        """The noise of a camera with a response curve."""
        full_scale = (1 << self.bit_depth) - 1
        return CameraNoise(
            full_well_e=self.full_well_e,
            read_noise_e=self.read_noise_e,
            dark_signal_e=self.dark_signal_e,
            black=self.black_level_dn / full_scale,
            full_scale=full_scale,
            response=response,
            prnu=self.prnu,
            dsnu_e=self.dsnu_e,
            cut=_BAYER_CUT if self.bayer else CameraNoise.cut,
            correlated=_BAYER if self.bayer else 1.0,
            coarse_colours=self.jpeg,
        )
