"""A wall without a picture: grain, vessels and shading drawn at random."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from optics.wall_light import texture

_LEAST = 0.0031308  # linear, below which sRGB is straight (IEC 61966-2-1)


def write_random_wall(path: Path, *, seed: int, width_mm: float) -> None:
    """Write a grey picture whose log reflectance is a Gaussian process.

    Its covariance is `optics.wall_light.texture`, by the discrete Fourier transform, so that the
    picture repeats at its border. The median reflectance is half of white.

    Args:
        path: of the PNG file, 16 bits, for phantom.wall_image.
        seed: random seed.
        width_mm: of the picture, a square; its 1024 pixels must resolve the grain of 0.08 mm.
    """
    pixels = 1024
    along = np.minimum(np.arange(pixels), pixels - np.arange(pixels)) * width_mm / pixels
    covariance = np.asarray(texture(np.hypot(along[:, None], along)))
    amplitude = np.sqrt(np.maximum(np.fft.fft2(covariance).real, 0.0))
    white = np.random.default_rng(seed).standard_normal((pixels, pixels))
    log_reflectance = np.fft.ifft2(np.fft.fft2(white) * amplitude).real
    linear = np.clip(0.5 * np.exp(log_reflectance), _LEAST, 1.0)
    coded = 1.055 * linear ** (1 / 2.4) - 0.055
    cv2.imwrite(str(path), np.round(65535 * coded).astype(np.uint16))
