"""One refinement of a spot without an edge: the whole of a bell, in logarithms.

On a bell the wall's texture cannot be told from the edge in a band along the contour. In the
logarithm of the signal texture is an additive disturbance, and all of the bell's area averages it.
"""

from __future__ import annotations

import math
from dataclasses import replace

import cv2
import numpy as np

from .censored import READABLE
from .ellipse import Ellipse, robust_step
from .levels import RADII, Levels
from .refine import FURTHEST, Refined
from .spot import NoSpot, Reason
from .unwrap import DESIGN, Patch

BROAD = 0.33
"""Edge width, in radii, from which a spot is treated as a bell; a Gaussian has 0.58."""

_FAINTEST = 0.1  # of the peak: signal above background that still counts
_CLIPPED = 0.03  # part of a ring at full scale from which its mean is wrong
_HIDDEN_TOP = 0.5  # radius to which the bell may be saturated and its peak still be extrapolated
_OUTLYING = 0.6  # difference from the mean bell, of logarithms, of what is not the lit wall
_SQUARE = RADII * RADII
_POWERS = np.stack([_SQUARE**k for k in range(4)], axis=1)
_POWERS_SLOPE = np.stack([2 * k * _SQUARE**k for k in range(4)], axis=1)  # RADII * d/dRADII


def refine_bell(
    patch: Patch, ellipse: Ellipse, inliers: np.ndarray, levels: Levels
) -> Refined | NoSpot:
    """Ellipse of a bell's half-maximum contour.

    The logarithm of the signal above background is an even polynomial q(t) of the elliptical
    radius, the same on all rays but for the ray's scale: a contour further out by a part w shows
    as -w t q'(t), fitted over all of the ray, weighted with the area that a sample stands for.

    Args:
        patch: signal round the spot.
        ellipse: to start from.
        inliers: rays that make the mean bell.
        levels: of the spot.

    Returns:
        The refined ellipse, or why there is none.
    """
    profiles = patch.unwrapped(ellipse, RADII)
    inside = ~np.isnan(profiles[:, np.searchsorted(RADII, 1.0)])
    above = np.nan_to_num(profiles, nan=0.0) - levels.background
    counts = above > _FAINTEST * levels.amplitude
    clipped = np.mean(profiles[inliers] > READABLE * patch.ceiling, axis=0) > _CLIPPED
    if clipped[RADII > _HIDDEN_TOP].any():
        return NoSpot(Reason.SATURATED)
    counts[:, clipped] = False
    logs = np.log(np.where(counts, above, 1.0) / levels.amplitude)
    mean = _mean_bell(logs, counts & inliers[:, None])
    if mean is None:
        return NoSpot(Reason.NONE_FOUND)
    counts &= np.abs(logs - _POWERS @ mean) < _OUTLYING
    mean = _mean_bell(logs, counts & inliers[:, None])
    if mean is None:
        return NoSpot(Reason.NONE_FOUND)
    signature = -_POWERS_SLOPE @ mean
    weight = counts * (RADII * signature)
    strength = weight @ signature
    offsets = ((logs - _POWERS @ mean) * weight).sum(axis=1) / np.maximum(strength, 1e-9)
    found = inside & (strength > 0.5 * np.median(strength[inliers]))
    fitted = robust_step(DESIGN, offsets, found, inliers, tolerance=FURTHEST, limit=2 * FURTHEST)
    half = _half_radius(mean)
    if fitted is None or half is None or np.abs(fitted[0]).max() > 0.5:
        return NoSpot(Reason.NONE_FOUND)
    step, inliers = fitted
    peak, radius, steepness = half
    width = 2 / (math.sqrt(2 * math.pi) * steepness)
    return Refined(
        ellipse=ellipse.stepped(step).scaled(radius),
        move=max(float(np.abs(step).max()), abs(radius - 1)),
        size_variance=math.pi / 2 * width**2 * levels.dome_variance,
        levels=replace(
            levels,
            peak=levels.background + levels.amplitude * peak,
            width=width,
        ),
        offsets=offsets - DESIGN @ step,
        found=found,
        inliers=inliers,
        inside=inside,
    )


def _mean_bell(logs: np.ndarray, counts: np.ndarray) -> np.ndarray | None:
    """Coefficients of the even polynomial through the rings' means."""
    number = np.count_nonzero(counts, axis=0)
    # A ring that only its bright places exceed the faintest level would be a biased mean.
    number = np.where(number > 0.7 * number.max(), number, 0)
    if np.count_nonzero(number) < 8:
        return None
    means = (logs * counts).sum(axis=0) / np.maximum(number, 1)
    weighted = _POWERS * (RADII * number)[:, None]
    solved, coefficients = cv2.solve(weighted.T @ _POWERS, weighted.T @ means[:, None])
    return coefficients[:, 0] if solved else None


def _half_radius(mean: np.ndarray) -> tuple[float, float, float] | None:
    """Peak, radius of half of it, and the logarithm's steepness there, per unit of that radius."""
    curve = _POWERS @ mean
    peak = max(float(curve.max()), float(mean[0]))
    below = np.flatnonzero((curve < peak - math.log(2)) & (RADII > 0.3))
    if below.size == 0 or below[0] == 0:
        return None
    k = int(below[0])
    share = (curve[k - 1] - peak + math.log(2)) / (curve[k - 1] - curve[k])
    radius = float(RADII[k - 1] + share * (RADII[k] - RADII[k - 1]))
    powers = radius ** (2 * np.arange(4))
    return math.exp(peak), radius, -float(2 * np.arange(4) * powers @ mean)
