"""Fisher information of the sensor about the light of a pixel."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.special import log_ndtr

from scenes.description import CameraSettings


def light_information(
    light: NDArray[np.floating], *, exposure: float, settings: CameraSettings
) -> NDArray[np.float64]:
    r"""Fisher information of each digital number about the light of its pixel.

    With $\mu$ electrons the number is normal with the variance $\mu$ plus dark signal, read noise
    and rounding, and clipped at full scale. Of a normal number that is clipped at $z$ standard
    deviations above its mean, the part

    $$\Phi(z) - z\varphi(z) + \varphi(z)^2/(1 - \Phi(z))$$

    of the information $1/\sigma^2$ remains (Tobin 1958; the first two derivatives of the clipped
    likelihood). The variance's own dependence on the light, which adds 1/(2 μ) of it, the fixed
    patterns, JPEG, and the rounding of a response curve are ignored.

    Args:
        light: noise-free light, H x W x 3, as for `expose`.
        exposure: full wells per unit of `light`.
        settings: the camera; behind a Bayer filter each pixel has one colour.

    Returns:
        Per squared unit of `light`, H x W x 3; 0 for colours that a pixel does not measure.
    """
    per_light = exposure * settings.full_well_e
    electrons = np.asarray(light, dtype=float) * per_light + settings.dark_signal_e
    variance = np.maximum(electrons, 0.0) + settings.dark_variance_e2
    z = (settings.full_well_e - electrons) / np.sqrt(variance)
    density = np.exp(-0.5 * z**2) / np.sqrt(2 * np.pi)
    below = np.exp(log_ndtr(z))
    # phi/(1 - Phi) is close to z far above the mean, where both vanish.
    above = np.exp(-0.5 * z**2 - log_ndtr(-z)) / np.sqrt(2 * np.pi)
    kept = np.clip(below - z * density + density * above, 0.0, 1.0)
    information = per_light**2 * kept / variance
    if settings.bayer != "none":
        information = information * _measured(information.shape[:2], settings.bayer)
    return np.asarray(information)


def _measured(shape: tuple[int, int], bayer: str) -> NDArray[np.float64]:
    """1 for the colour that each pixel measures, H x W x 3."""
    measured = np.zeros((*shape, 3))
    for position, colour in enumerate(bayer):
        row, column = divmod(position, 2)
        measured[row::2, column::2, "RGB".index(colour)] = 1.0
    return measured
