"""One refinement of a spot with a sharp edge.

The wall's reflectance is removed from each ray as a gain and a gradient, so that the ray's edge is
where its own light is half.
"""

from __future__ import annotations

import math
from dataclasses import replace
from statistics import NormalDist

import cv2
import numpy as np

from estimator.detector.band import Band, Refined
from estimator.detector.censored import hidden_edge
from estimator.detector.ellipse import Ellipse, robust_step
from estimator.detector.levels import Levels
from estimator.detector.tuning import RAYS, Refine, Saturated, Sharp
from estimator.detector.unwrap import DESIGN, Patch, ring_variance
from estimator.image import NoSpot, Reason

_NORMAL = NormalDist()

_SLOPES = np.column_stack([np.ones(RAYS), DESIGN[:, :2]])
_NEIGHBOURS = np.ones((1, 2 * Sharp.SPOILED_RAYS + 1), np.uint8)


def refine_sharp(
    patch: Patch, ellipse: Ellipse, inliers: np.ndarray, levels: Levels
) -> Refined | NoSpot:
    """Ellipse of the half-maximum contour, from one that is off by less than the edge's width.

    Args:
        patch: signal round the spot.
        ellipse: to start from.
        inliers: rays that make the mean profile.
        levels: of the spot.

    Returns:
        The refined ellipse, or why there is none.
    """
    reach = max(Sharp.REACH * levels.width, Sharp.REACH_PX / ellipse.axes()[1])
    if reach >= 1:  # the pixel grid hides the whole ellipse
        return NoSpot(Reason.TOO_SMALL)
    band = Band.along(patch, ellipse, inliers, reach)
    if band is None:
        return NoSpot(Reason.NONE_FOUND)
    full = band.profiles[band.inliers, 0] > Saturated.READABLE * patch.ceiling
    saturated = bool(2 * np.count_nonzero(full) > full.size)
    # Stretched about the edge itself: otherwise a ray with a narrower edge would seem shifted.
    middle = 0.0 if saturated else band.middle
    stretch = (band.from_edge - middle) * band.slope
    shifts, rough = band.shifts([stretch, band.mean], past_texture=True)
    gain = band.gain
    offsets = shifts / np.maximum(
        gain, Refine.DARKEST_GAIN
    )  # a shift changes a brighter ray by more
    found = (
        band.whole
        & (gain > Refine.DARKEST_GAIN)
        & (gain < Refine.BRIGHTEST_GAIN)
        & (np.abs(offsets) < reach)
    )
    plain = rough[found]
    if not plain.size:
        return NoSpot(Reason.NONE_FOUND)
    typical = float(np.partition(plain, plain.size // 2)[plain.size // 2])
    smooth = rough < Sharp.ROUGH * max(typical, 1e-5 * levels.amplitude**2)
    shaded = np.zeros(RAYS, bool)
    if not saturated and bool((band.whole & (gain <= Refine.DARKEST_GAIN)).any()):
        light, shaded_shifts, misfit = band.in_shade(stretch)
        shaded = _eroded(
            band.whole
            & (gain <= Refine.DARKEST_GAIN)
            & (light > Sharp.DEEPEST_SHADE)
            & (misfit < Sharp.SHADED_MISFIT * levels.amplitude)
            & (np.abs(shaded_shifts) < reach)
        )
        offsets = np.where(shaded, shaded_shifts, offsets)
    fitted = robust_step(
        DESIGN,
        offsets,
        _eroded(found & smooth) | shaded,
        band.inliers,
        tolerance=Sharp.FORGIVEN * levels.width,
        limit=Refine.FURTHEST,
    )
    if fitted is None or np.abs(fitted[0]).max() > Refine.LARGEST_STEP:
        return NoSpot(Reason.NONE_FOUND)
    if saturated:
        hidden = hidden_edge(patch, ellipse, fitted[1], levels, reach)
        if hidden is None:
            return NoSpot(Reason.SATURATED)
        levels, half, variance = hidden
        return band.refined(
            levels, offsets, found, fitted, half=half, half_variance=variance, shaded=shaded
        )
    slope, doubt = _slope(band, found, levels.width)
    levels = _sharpened(levels, band, slope, doubt)
    crossing = band.half_crossing(levels.half, Sharp.MIDDLE * levels.width)
    if crossing is None or not levels.width > 0:
        return NoSpot(Reason.NONE_FOUND)
    # A ray's shift is where its own light is half. Half of the common peak lies further out on the
    # brighter rays.
    step, rays = fitted
    per_slope = math.sqrt(math.pi / 2) * levels.width
    aside = per_slope * slope
    step[:2] += aside
    offsets = offsets + DESIGN[:, :2] @ aside
    return band.refined(
        levels,
        offsets,
        found | shaded,
        (step, rays),
        half=crossing,
        half_variance=(Sharp.SIZE_PX / ellipse.axes()[1]) ** 2,
        centre_variance=per_slope**2 * doubt / 2,
        shaded=shaded,
    )


def _eroded(mask: np.ndarray) -> np.ndarray:
    """Rays whose neighbours are all in the mask: the rim of a shaft disturbs the rays beside it."""
    wide = np.concatenate([mask[-Sharp.SPOILED_RAYS :], mask, mask[: Sharp.SPOILED_RAYS]]).view(
        np.uint8
    )
    return cv2.erode(wide[None], _NEIGHBOURS)[0, Sharp.SPOILED_RAYS : -Sharp.SPOILED_RAYS].view(
        bool
    )


def _sharpened(levels: Levels, band: Band, slope: np.ndarray, doubt: float) -> Levels:
    """The levels with the edge's width, the plateau and its slope as the band shows them."""
    width = band.width(levels)
    inner = int(np.count_nonzero(band.from_edge < -Sharp.PLATEAU * width))
    if inner == 0 or not width > 0:
        return replace(levels, width=width)
    radii = 1 + band.from_edge[:inner]
    left = _left_by_blur(levels, width, radii)
    light = float(band.mean[:inner].sum()) - levels.background * float((1 - left).sum())
    peak = light / float(levels.share_of_peak(radii) @ left)
    if not peak > levels.background:
        return levels
    rise = math.hypot(*slope) * max(1 - Sharp.BRIGHTEST_INSIDE * width, 0.0)
    peak += rise * (peak - levels.background)
    return replace(levels, width=width, peak=peak, variance=levels.variance + doubt)


def _slope(band: Band, found: np.ndarray, width: float) -> tuple[np.ndarray, float]:
    """Slope of the light across the plateau, over its mean per radius, (2,), and its variance.

    A beam that meets the wall obliquely is brighter on the near side. Texture is uneven, too, so
    the slope counts only as far as it exceeds what shorter waves explain (the garrote of Breiman
    1995).
    """
    # A slope moves a sharp edge so little that a wrong estimate of it would do more harm.
    counts = min(max(width / Sharp.SLOPE_SHOWS - 1, 0.0), 1.0)
    if counts == 0:
        return np.zeros(2), 0.0
    waves = np.where(found[:, None], _SLOPES, 0.0)
    _, fitted = cv2.solve(waves.T @ waves, waves.T @ band.gain[:, None].astype(float))
    slope = fitted[1:, 0] / fitted[0, 0]
    square = float(slope @ slope)
    rest = np.where(found, band.gain, 0.0) - waves @ fitted[:, 0]
    variance = Sharp.SLOPE_DOUBT * 2 * ring_variance(rest, slice(2, 7)) / RAYS
    kept = counts * max(0.0, 1 - variance / square) if square > 0 else 0.0
    return kept * slope, kept * variance + kept * (1 - kept) * square


def _left_by_blur(levels: Levels, width: float, radii: np.ndarray) -> np.ndarray:
    """Fraction of a plateau that a Gaussian blur leaves at radii inside 1, the half level's."""
    rim = float(levels.share_of_peak(np.ones(1))[0]) * levels.peak - levels.background
    height = min(max(rim / levels.amplitude, 0.51), 1.0)
    middle = _NORMAL.inv_cdf(0.5 / height)
    return np.array([_NORMAL.cdf(middle + (1 - r) / (width * height)) for r in radii.tolist()])
