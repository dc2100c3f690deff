"""The wall's texture told from its colours.

Blood and pigment take more of one colour than of another, while light from one source falls off
alike in all. Of the products of the channels' powers with exponents that sum to one, which leave
such light as it is, the one that varies least over short distances shows the least of the wall: the
beamformer of Capon (1969) on the logarithms. It cannot take out what is as dark in every colour.
"""

from __future__ import annotations

import cv2
import numpy as np

_CELLS = 16  # across a semi-minor axis: finer texture averages out round a contour
_SHORT = 2.4  # cells that short distances are below
_DARKEST = 0.008  # of full scale: below is noise


def without_texture(
    light: np.ndarray, colours: np.ndarray, *, semi_minor_px: float, full_scale: float
) -> np.ndarray:
    """Light of one channel over the texture that its colours tell, (h, w) float32.

    Args:
        light: (h, w) float32, of the channel or the grey mean to be measured in.
        colours: (h, w, 3) float32 light, nowhere saturated.
        semi_minor_px: of the spot in it.
        full_scale: of the light.
    """
    height, width = light.shape
    cell = max(semi_minor_px / _CELLS, 1.0)
    cells = max(round(width / cell), 1), max(round(height / cell), 1)
    channels = np.dstack([colours, light])
    channels = cv2.resize(channels, cells, interpolation=cv2.INTER_AREA)
    logarithms = cv2.log(np.maximum(channels, np.float32(_DARKEST * full_scale)))
    # Twice, as the logarithm of a bell is curved, and of another colour than the rest's light.
    short = _without_long_waves(_without_long_waves(logarithms[..., :3])).reshape(-1, 3)
    bright = channels[..., 3].reshape(-1, 1)  # where the logarithms' noise is least
    varying = (short * bright).T @ (short * bright)
    varying.flat[::4] += 1e-6 * varying.trace() + 1e-30
    exponents = np.linalg.solve(varying, np.ones(3, np.float32))
    texture = logarithms[..., 3] - logarithms[..., :3] @ (exponents / exponents.sum())
    texture -= np.median(texture)
    return light / cv2.resize(cv2.exp(texture), (width, height), interpolation=cv2.INTER_LINEAR)


def _without_long_waves(image: np.ndarray) -> np.ndarray:
    return image - cv2.GaussianBlur(image, (0, 0), _SHORT)
