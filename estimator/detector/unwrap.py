"""Profiles along the rays of an ellipse: sampling, and statistics round the ring of rays."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache

import cv2
import numpy as np

from estimator.detector.ellipse import Ellipse, offset_design
from estimator.detector.tuning import RAYS, ErrorGrowth, Refine

_ANGLES = 2 * np.pi * np.arange(RAYS) / RAYS
_COS, _SIN = np.cos(_ANGLES), np.sin(_ANGLES)
_ACROSS = np.stack([_COS, _SIN])
_ALONG = np.stack([-_SIN, _COS])

DESIGN = offset_design(_COS, _SIN)
"""Radial offsets of the rays' edges by the parameters of `Ellipse.stepped`, (RAYS, 5)."""


@dataclass(frozen=True, eq=False)
class Patch:
    """Signal of a rectangle of a frame, maybe subsampled.

    Attributes:
        signal: (h, w) float32.
        x0: column of the frame under the first pixel, px.
        y0: row of the frame under the first pixel, px.
        stride: px of the frame per pixel.
        ceiling: signal at which pixels are clipped; infinite if none is.
        clipped: fraction of the spot's pixels that are.
    """

    signal: np.ndarray
    x0: float
    y0: float
    stride: float = 1.0
    ceiling: float = math.inf
    clipped: float = 0.0

    def unwrapped(self, ellipse: Ellipse, radii: np.ndarray, every: int = 1) -> np.ndarray:
        """Bilinear samples on the ellipse's rays, (RAYS / every, radii); NaN outside the patch.

        Args:
            ellipse: in the frame, px.
            radii: in units of the ellipse, 1 on its contour.
            every: takes every n-th ray only.
        """
        centre = (ellipse.centre - (self.x0, self.y0)) / self.stride
        rays = (ellipse.shape / self.stride) @ _ACROSS[:, ::every]
        x, y = centre.astype(np.float32)[:, None, None] + np.multiply.outer(
            rays.astype(np.float32), radii.astype(np.float32)
        )
        return cv2.remap(
            self.signal,
            x,
            y,
            cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_CONSTANT,
            borderValue=math.nan,
        )

    def contains(self, ellipse: Ellipse) -> bool:
        """Whether the whole ellipse lies on the patch."""
        half_width, half_height = ellipse.half_extent()
        height, width = self.signal.shape
        x = (ellipse.centre[0] - self.x0, half_width, (width - 1) * self.stride)
        y = (ellipse.centre[1] - self.y0, half_height, (height - 1) * self.stride)
        return all(half <= at <= length - half for at, half, length in (x, y))


def contour_points(ellipse: Ellipse, offsets: np.ndarray) -> np.ndarray:
    """Image points (RAYS, 2) at radial offsets from the ellipse, px."""
    return ellipse.centre + ((1 + offsets) * (ellipse.shape @ _ACROSS)).T


def normals_of(ellipse: Ellipse) -> tuple[np.ndarray, np.ndarray]:
    """Outward unit normals on the rays, (2, RAYS), and radii per px along them, (RAYS,)."""
    gradients = np.linalg.inv(ellipse.shape).T @ _ACROSS
    per_px = np.hypot(*gradients)
    return gradients / per_px, per_px


def shares_of_contour(ellipse: Ellipse, *masks: np.ndarray) -> list[float]:
    """Fraction of the contour's length that belongs to the rays in each mask."""
    steps = np.hypot(*(ellipse.shape @ _ALONG))
    length = float(steps.sum())
    return [float(steps @ mask) / length for mask in masks]


def ring_variance(values: np.ndarray, harmonics: slice) -> float:
    """Variance per ray of values round the ring, at the wavelengths of the harmonics.

    Neighbouring rays share pixels and texture, so their plain scatter underestimates the error of a
    mean over the ring; the spectrum at long wavelengths does not.
    """
    return ring_variances(values, harmonics)[0]


def ring_variances(values: np.ndarray, *harmonics: slice) -> list[float]:
    """`ring_variance` of several ranges of harmonics."""
    parts = [values @ _waves(some.start, some.stop) for some in harmonics]
    return [float(part @ part) * 2 / part.size for part in parts]


def red_share(values: np.ndarray, long: slice) -> tuple[float, float]:
    """How far the long waves of values round the ring are a wall's texture, and its steepness.

    The variance of texture rises with a power of the wavelength, of fringes and noise it does not.
    What rises more steeply than texture is the shape of a beam that is no ellipse.

    Args:
        values: (RAYS,).
        long: harmonics.

    Returns:
        The share of texture in the variance of the long waves; and the power, which so few waves
        leave open by half a power, as much as walls differ: the mean of the frame's and the walls'.
    """
    longer, shorter = ring_variances(values, long, Refine.NEXT_WAVES_BROAD)
    ratio = math.log(octaves_middle(Refine.NEXT_WAVES_BROAD) / octaves_middle(long))
    seen = math.log(max(longer, 1e-30) / max(shorter, 1e-30)) / ratio
    share = math.exp(min(0.0, ErrorGrowth.STEEPEST - seen) * ratio)
    steepness = (min(max(seen, 0.0), ErrorGrowth.STEEPEST) + ErrorGrowth.STEEPNESS) / 2
    return share, steepness


def octaves_middle(harmonics: slice) -> float:
    """Geometric mean of the harmonics."""
    return float(np.exp(np.log(np.arange(harmonics.start, harmonics.stop)).mean()))


@cache
def _waves(first: int, end: int) -> np.ndarray:
    """Cosines and sines of harmonics round the ring, (RAYS, 2 (end - first))."""
    phases = np.multiply.outer(_ANGLES, np.arange(first, end))
    return np.concatenate([np.cos(phases), np.sin(phases)], axis=1) / math.sqrt(RAYS)
