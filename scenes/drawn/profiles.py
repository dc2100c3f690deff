"""Profiles of the light across the edge: sharp, domed, bell-shaped, or of a glue lens."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from statistics import NormalDist

import numpy as np
from scipy.special import ndtr

import optics

_FURTHEST_RADIUS = 8.0  # in half-maximum radii; the light is zero beyond it
_SAMPLES = 4000


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


@functools.cache
def lens_profile(preset: str, medium_index: float, distance_mm: float) -> Profile:
    """Profile of a glue lens on a plane perpendicular to the axis.

    Args:
        preset: name of the lens, see `optics.lens_names`.
        medium_index: refractive index of the medium in front.
        distance_mm: distance of the plane from the tip.
    """
    table = optics.irradiance_table(optics.load_lens(preset), medium_index=medium_index)
    half_radius = float(optics.half_maximum_radius(table, distance=distance_mm))
    radii = np.linspace(0, _FURTHEST_RADIUS, _SAMPLES)
    _, light = table(radius=radii * half_radius, distance=distance_mm)
    relative = np.asarray(light / light.max())
    return lambda t, distance: np.interp(t, radii, relative, right=0.0)
