"""Profiles of the light across the edge: sharp, domed, with a flank, or bell-shaped."""

from __future__ import annotations

import math
from collections.abc import Callable
from statistics import NormalDist

import numpy as np
from scipy.special import ndtr

Profile = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""Light (peak 1) from the elliptical radius (1 on the contour) and the distance from it in px."""


def erf_edge(sigma_px: float) -> Profile:
    """Uniform disc with an edge blurred by a Gaussian."""
    return lambda t, distance: ndtr(-distance / sigma_px)


def domed_edge(sigma_px: float, drop: float) -> Profile:
    """Disc whose light falls by `drop` from the centre to the rim, with the same blur."""
    # On the contour, dome times edge is 1/2, so the middle of the edge lies further inside.
    shift = NormalDist().inv_cdf(0.5 / (1 - drop))
    return lambda t, distance: (1 - drop * t * t) * ndtr(shift - distance / sigma_px)


def flank(width: float) -> Profile:
    """Plateau with a linear flank, `width` radii wide, as behind a flat glue lens."""
    return lambda t, distance: np.clip(0.5 + (1 - t) / width, 0, 1)


def bell(t: np.ndarray, distance: np.ndarray) -> np.ndarray:
    """Gaussian profile."""
    return np.exp(-math.log(2) * t * t)
