"""One refinement of a spot with a broad flank: a bell, or a plateau that falls off slowly.

To take the wall's reflectance out of each ray would take out the light's own slope across the spot
as well, which on a broad flank moves the half level by more than texture does. So the same level
counts on all rays, and texture is left to average out round the contour.
"""

from __future__ import annotations

import math
from dataclasses import replace

import cv2
import numpy as np

from estimator.detector.band import FURTHEST, Band, Refined
from estimator.detector.censored import READABLE
from estimator.detector.ellipse import Ellipse, robust_step
from estimator.detector.levels import RADII, Levels
from estimator.detector.unwrap import DESIGN, RAYS, Patch, ring_variance
from estimator.image import NoSpot, Reason

BROAD = 0.17
"""Edge width, in radii, from which an edge is a broad flank; a Gaussian bell has 0.58."""

_FLANK = 0.9  # edge widths on either side of the half level that are the flank ...
_WIDEST = 0.5  # ... and at most so many radii
_FORGIVEN = 0.3  # edge widths that texture may move an edge
_SHOULDER = 1.25  # edge widths from the edge to where a plateau begins to fall
_SMALLEST_TOP = 0.35  # radii of a spot's top that are looked at at least
_DOUBT = 4.0  # variances that a top's shape must exceed to count
_POWERS = 5  # of the polynomial in the radius through a top
_TOP_AND_CONTOUR = 18.0  # longest-wave texture over that, in variance, as on printed retinas


def refine_broad(
    patch: Patch, ellipse: Ellipse, inliers: np.ndarray, levels: Levels
) -> Refined | NoSpot:
    """Ellipse of the half-maximum contour, from one that is off by less than the flank's width.

    Args:
        patch: signal round the spot.
        ellipse: to start from.
        inliers: rays that make the mean profile.
        levels: of the spot.

    Returns:
        The refined ellipse, or why there is none.
    """
    levels = _with_sloping_top(levels, patch, ellipse, inliers)
    if levels.peak > READABLE * patch.ceiling:
        return NoSpot(Reason.SATURATED)
    reach = min(_FLANK * levels.width, _WIDEST)
    band = Band.along(patch, ellipse, inliers, reach)
    if band is None:
        return NoSpot(Reason.NONE_FOUND)
    offsets, _ = band.shifts([band.from_edge * band.slope])
    gain = band.gain
    found = band.whole & (gain > 0.5) & (gain < 2) & (np.abs(offsets) < reach)
    fitted = robust_step(
        DESIGN,
        offsets,
        found,
        band.inliers,
        tolerance=_FORGIVEN * levels.width,
        limit=max(levels.width, FURTHEST),
    )
    crossing = band.half_crossing(levels.half, reach)
    if fitted is None or crossing is None or np.abs(fitted[0]).max() > 0.5:
        return NoSpot(Reason.NONE_FOUND)
    # The wall under the top is not that under the contour: by the texture of the longest waves,
    # which the contour shows only where they are not the light's own.
    texture = ring_variance(np.where(found, gain - 1, 0.0), slice(2, 5)) / RAYS
    variance = levels.variance + _TOP_AND_CONTOUR * texture
    levels = replace(levels, width=band.width(levels), variance=variance)
    return band.refined(levels, offsets, found, fitted, half=crossing, half_variance=0.0)


def _simple_peak(gram: np.ndarray, pull: np.ndarray) -> float:
    """Peak of the parabola, from the normal equations of a fit with higher powers."""
    few = [0, 2]
    _, parabola = cv2.solve(gram[np.ix_(few, few)], pull[few])
    return float(parabola[0, 0])


def _with_sloping_top(
    levels: Levels, patch: Patch, ellipse: Ellipse, inliers: np.ndarray
) -> Levels:
    """The levels with the peak of a top that slopes.

    A beam that meets the wall obliquely is brighter on the near side, and a focused one has a cusp:
    the peak is the maximum of a polynomial in the radius plus a slope across. Texture has cusps and
    slopes too, so they count, beside a parabola's peak, only as far as they exceed what the rest of
    the rays' spectrum explains (the garrote of Breiman 1995).
    """
    top = min(max(1 - _SHOULDER * levels.width, _SMALLEST_TOP), 0.9)
    radii = RADII[: max(int(np.searchsorted(RADII, top)), 8)]
    inner = np.nan_to_num(patch.unwrapped(ellipse, radii), nan=0.0)
    seen = (inner > levels.half) & (inner < 2 * levels.peak) & inliers[:, None]
    if np.count_nonzero(seen) < 10 * _POWERS:
        return levels
    area = seen * radii
    across = DESIGN[:, :2]
    slopes = across[:, :1] * radii, across[:, 1:] * radii
    rings = [np.broadcast_to(radii**k, inner.shape) for k in range(_POWERS)]
    basis = np.stack([column[seen] for column in (*rings, *slopes)], axis=1)
    weighted = basis * area[seen][:, None]
    gram = weighted.T @ basis
    gram.flat[:: len(gram) + 1] += 1e-6
    _, solution = cv2.solve(gram, weighted.T @ inner[seen].astype(float)[:, None])
    profile = np.stack([radii**k for k in range(_POWERS)], axis=1) @ solution[:_POWERS, 0]
    tilt = solution[_POWERS:, 0]
    left = np.where(seen, inner - profile - (across @ tilt)[:, None] * radii, 0.0)
    lever = float((area * radii).sum() / RAYS)
    pull_variance = ring_variance((left * area).sum(axis=1) / lever, slice(2, 6)) / RAYS
    simple = _simple_peak(gram, weighted.T @ inner[seen].astype(float)[:, None])
    rise = float((profile + math.hypot(*tilt) * radii).max()) - simple
    kept = max(0.0, 1 - _DOUBT * pull_variance / rise**2) if rise else 0.0
    peak = simple + kept * rise
    if not peak > levels.background:
        return levels
    return replace(levels, peak=peak, dome=(1.0, 0.0, 0.0), variance=pull_variance / peak**2)
