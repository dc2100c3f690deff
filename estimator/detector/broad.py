"""One refinement of a spot with a broad flank: a bell, or a plateau that falls off slowly.

Removing the wall's reflectance from each ray would also remove the slope of the light across the
spot, which on a broad flank moves the half level by more than texture does. So all rays share one
level, and texture averages out round the contour.
"""

from __future__ import annotations

import math
from dataclasses import replace

import cv2
import numpy as np

from estimator.detector.band import Band, Refined
from estimator.detector.censored import hidden_bell
from estimator.detector.ellipse import Ellipse, robust_step
from estimator.detector.levels import RADII, Levels
from estimator.detector.tuning import RAYS, Broad, Refine, Saturated
from estimator.detector.unwrap import DESIGN, Patch, octaves_middle, red_share, ring_variance
from estimator.image import NoSpot, Reason


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
    half, half_variance = None, 0.0
    if levels.peak > Saturated.READABLE * patch.ceiling:
        hidden = hidden_bell(patch, ellipse, inliers, levels)
        if hidden is None:
            return NoSpot(Reason.SATURATED)
        levels, half, half_variance = hidden
    reach = min(Broad.FLANK * levels.width, Broad.WIDEST)
    band = Band.along(patch, ellipse, inliers, reach)
    if band is None:
        return NoSpot(Reason.NONE_FOUND)
    offsets, _ = band.shifts([band.from_edge * band.slope], past_texture=False)
    gain = band.gain
    found = (
        band.whole
        & (gain > Refine.DARKEST_GAIN)
        & (gain < Refine.BRIGHTEST_GAIN)
        & (np.abs(offsets) < reach)
    )
    fitted = robust_step(
        DESIGN,
        offsets,
        found,
        band.inliers,
        tolerance=Broad.FORGIVEN * levels.width,
        limit=max(levels.width, Refine.FURTHEST),
    )
    if half is None:
        half = band.half_crossing(levels.half, reach)
    if fitted is None or half is None or np.abs(fitted[0]).max() > Refine.LARGEST_STEP:
        return NoSpot(Reason.NONE_FOUND)
    levels = replace(levels, width=band.width(levels))
    if half_variance == 0:
        # The wall under the top differs from the wall under the contour by texture of the longest
        # waves, which the contour shows only as far as they are not the light's own slope.
        light = np.where(found, gain - 1, 0.0)
        share, steepness = red_share(light, Broad.TOP_WAVES)
        growth = Broad.TOP_OVER_CONTOUR * octaves_middle(Broad.TOP_WAVES) ** steepness
        texture = share * growth * ring_variance(light, Broad.TOP_WAVES) / RAYS
        variance = levels.variance + texture + Broad.PEAK_ERROR**2
        levels = replace(levels, variance=variance)
    shaded = np.zeros(RAYS, bool)  # a shadow's rim looks like a broad flank
    return band.refined(
        levels, offsets, found, fitted, half=half, half_variance=half_variance, shaded=shaded
    )


def _simple_peak(gram: np.ndarray, pull: np.ndarray) -> float:
    """Peak of the parabola, from the normal equations of a fit with higher powers."""
    few = [0, 2]
    _, parabola = cv2.solve(gram[np.ix_(few, few)], pull[few])
    return float(parabola[0, 0])


def _with_sloping_top(
    levels: Levels, patch: Patch, ellipse: Ellipse, inliers: np.ndarray
) -> Levels:
    """The levels with the peak of a top that slopes.

    A beam that meets the wall obliquely is brighter on the near side, and a focused beam has a
    cusp: the peak is the maximum of a polynomial in the radius plus a slope across. Texture has
    cusps and slopes too. So they raise the peak above a parabola's only as far as they exceed what
    the rest of the rays' spectrum explains (the garrote of Breiman 1995).
    """
    top = min(max(1 - Broad.SHOULDER * levels.width, Broad.SMALLEST_TOP), Broad.LARGEST_TOP)
    radii = RADII[: max(int(np.searchsorted(RADII, top)), 8)]
    inner = np.nan_to_num(patch.unwrapped(ellipse, radii), nan=0.0)
    seen = (inner > levels.half) & (inner < 2 * levels.peak) & inliers[:, None]
    if np.count_nonzero(seen) < 10 * Broad.POWERS:
        return levels
    area = seen * radii
    across = DESIGN[:, :2]
    slopes = across[:, :1] * radii, across[:, 1:] * radii
    rings = [np.broadcast_to(radii**k, inner.shape) for k in range(Broad.POWERS)]
    basis = np.stack([column[seen] for column in (*rings, *slopes)], axis=1)
    weighted = basis * area[seen][:, None]
    gram = weighted.T @ basis
    gram.flat[:: len(gram) + 1] += 1e-6
    _, solution = cv2.solve(gram, weighted.T @ inner[seen].astype(float)[:, None])
    powers = np.vander(radii, Broad.POWERS, increasing=True)
    profile = powers @ solution[: Broad.POWERS, 0]
    tilt = solution[Broad.POWERS :, 0]
    left = np.where(seen, inner - profile - (across @ tilt)[:, None] * radii, 0.0)
    lever = float((area * radii).sum() / RAYS)
    pull_variance = ring_variance((left * area).sum(axis=1) / lever, slice(2, 6)) / RAYS
    simple = _simple_peak(gram, weighted.T @ inner[seen].astype(float)[:, None])
    rise = float((profile + math.hypot(*tilt) * radii).max()) - simple
    kept = max(0.0, 1 - Broad.TOP_DOUBT * pull_variance / rise**2) if rise else 0.0
    peak = simple + kept * rise
    if not peak > levels.background:
        return levels
    return replace(levels, peak=peak, dome=(1.0, 0.0, 0.0), variance=pull_variance / peak**2)
