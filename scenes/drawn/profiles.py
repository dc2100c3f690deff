"""Light of a drawn spot across its edge: sharp, domed, bell-shaped, or that of a glue lens."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from statistics import NormalDist

import numpy as np
from scipy.special import ndtr

import optics

_FURTHEST_RADIUS = 8.0  # half-maximum radii: beyond, the light does not count
_SAMPLES = 4000


Profile = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""Light, 1 at its peak, of the elliptical radius (1 on the truth) and the distance from it (px)."""


def erf_edge(sigma_px: float) -> Profile:
    """Flat disc with a Gaussian-blurred edge."""
    return lambda t, distance: ndtr(-distance / sigma_px)


def domed_edge(sigma_px: float, drop: float) -> Profile:
    """Disc that falls by `drop` of its peak from the middle to the rim, before the same blur."""
    # Dome times edge is 1/2 on the truth: a little outside the edge's own middle.
    shift = NormalDist().inv_cdf(0.5 / (1 - drop))
    return lambda t, distance: (1 - drop * t * t) * ndtr(shift - distance / sigma_px)


def flank(width: float) -> Profile:
    """Plateau that falls off linearly over `width` radii, as behind a flat glue lens."""
    return lambda t, distance: np.clip(0.5 + (1 - t) / width, 0, 1)


def bell(t: np.ndarray, distance: np.ndarray) -> np.ndarray:
    """Gaussian."""
    return np.exp(-math.log(2) * t * t)


@functools.cache
def lens_profile(preset: str, medium_index: float, distance_mm: float) -> Profile:
    """Irradiance of a plane square to the axis, by its vector irradiance; 1 on the half maximum.

    Args:
        preset: of the lens, see `optics.lens_names`.
        medium_index: of what is in front of it.
        distance_mm: of the plane from the tip.
    """
    table = optics.irradiance_table(optics.load_lens(preset), medium_index=medium_index)
    half_radius = float(optics.half_maximum_radius(table, distance=distance_mm))
    radii = np.linspace(0, _FURTHEST_RADIUS, _SAMPLES)
    _, light = table(radius=radii * half_radius, distance=distance_mm)
    relative = np.asarray(light / light.max())
    return lambda t, distance: np.interp(t, radii, relative, right=0.0)
