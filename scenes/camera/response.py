"""Response curves: from light to digital numbers and back, without noise."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scenes.description import CameraSettings

# A step of 16 bits is at most a twentieth of a step of the 8-bit output, even where sRGB is
# steepest (slope 12.92).
CONVERTER_MAX = (1 << 16) - 1
"""Full scale of the converter before a response curve."""


def full_wells(fraction: NDArray[np.float64], settings: CameraSettings) -> NDArray[np.float64]:
    """Light in full wells of a noise-free pixel whose output is a fraction of full scale."""
    if settings.response == "linear":
        straight = fraction
    elif settings.response == "srgb":
        power = ((fraction + 0.055) / 1.055) ** 2.4
        straight = np.where(fraction <= 0.04045, fraction / 12.92, power)
    else:
        straight = fraction**settings.response
    black = settings.black_level_dn / settings.full_scale_dn
    return (straight - black) / (1.0 - black) - settings.dark_signal_e / settings.full_well_e


def response_table(settings: CameraSettings) -> NDArray[np.uint8] | NDArray[np.uint16] | None:
    """Output for every converter value, or None for a linear camera."""
    if settings.response == "linear":
        return None
    straight = np.arange(CONVERTER_MAX + 1) / CONVERTER_MAX
    if settings.response == "srgb":
        power = 1.055 * straight ** (1 / 2.4) - 0.055
        curved = np.where(straight <= 0.0031308, 12.92 * straight, power)
    else:
        curved = straight ** (1.0 / settings.response)
    output = np.rint(curved * settings.full_scale_dn)
    return output.astype(np.uint8 if settings.bit_depth == 8 else np.uint16)
