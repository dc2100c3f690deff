"""One refinement of a spot with a sharp edge.

The wall's reflectance is taken out of each ray, as a gain and a gradient, so that its edge is where
its own light is half.
"""

from __future__ import annotations

import math
from dataclasses import replace
from statistics import NormalDist

import cv2
import numpy as np

from estimator.detector.band import FURTHEST, Band, Refined
from estimator.detector.censored import READABLE, hidden_edge
from estimator.detector.ellipse import Ellipse, robust_step
from estimator.detector.levels import Levels
from estimator.detector.unwrap import DESIGN, RAYS, Patch, ring_variance
from estimator.image import NoSpot, Reason

_NORMAL = NormalDist()

_REACH = 3.0  # edge widths on either side that hold all of an edge ...
_REACH_PX = 2.5  # ... and at least so many px
_MIDDLE = 0.8  # edge widths on either side of the half level that a cubic fits
_BRIGHTEST_INSIDE = 1.5  # edge widths from the edge to where a plateau that slopes is brightest
_DOUBTED = 100.0  # texture's longest wave over its next ones, in variance, that still is texture
_SLOPE_SHOWS = 0.02  # edge width, radii, from which a slope of the light begins to count
_SLOPES = np.column_stack([np.ones(RAYS), DESIGN[:, :2]])
_PLATEAU = 2.6  # edge widths from the edge to where its blur no longer shows
_FORGIVEN = 0.1  # edge widths that texture may move an edge
_SPOILED = 3  # rays beside one that shows no edge
_NEIGHBOURS = np.ones((1, 2 * _SPOILED + 1), np.uint8)
_ROUGH = 5.0  # times the typical variance left in a profile: it holds something else


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
    reach = max(_REACH * levels.width, _REACH_PX / ellipse.axes()[1])
    band = Band.along(patch, ellipse, inliers, reach)
    if band is None:
        return NoSpot(Reason.NONE_FOUND)
    saturated = bool(band.mean[0] > READABLE * patch.ceiling)
    # About the edge itself, or a ray with a narrower edge would seem shifted.
    middle = 0.0 if saturated else band.middle
    stretch, gradient = (band.from_edge - middle) * band.slope, band.from_edge * band.mean
    shifts, rough = band.shifts([stretch, band.mean, gradient])
    gain = band.gain
    offsets = shifts / np.maximum(gain, 0.5)  # a brighter ray's shift shows as much more strongly
    found = band.whole & (gain > 0.5) & (gain < 2) & (np.abs(offsets) < reach)
    plain = rough[band.inliers]
    typical = float(np.partition(plain, plain.size // 2)[plain.size // 2])
    smooth = rough < _ROUGH * max(typical, 1e-5 * levels.amplitude**2)
    fitted = robust_step(
        DESIGN,
        offsets,
        _eroded(found & smooth),
        band.inliers,
        tolerance=_FORGIVEN * levels.width,
        limit=FURTHEST,
    )
    if fitted is None or np.abs(fitted[0]).max() > 0.5:
        return NoSpot(Reason.NONE_FOUND)
    if saturated:
        hidden = hidden_edge(patch, ellipse, fitted[1], levels, reach)
        if hidden is None:
            return NoSpot(Reason.SATURATED)
        levels, half, variance = hidden
        return band.refined(levels, offsets, found, fitted, half=half, half_variance=variance)
    slope, doubt = _slope(band, found, levels.width)
    levels = _sharpened(levels, band, slope, doubt)
    crossing = band.half_crossing(levels.half, _MIDDLE * levels.width)
    if crossing is None or not levels.width > 0:
        return NoSpot(Reason.NONE_FOUND)
    # A ray's shift tells where half of its own light is. Of all light's half, brighter rays see it
    # further out.
    step, rays = fitted
    aside = math.sqrt(math.pi / 2) * levels.width * slope
    step[:2] += aside
    offsets = offsets + DESIGN[:, :2] @ aside
    return band.refined(levels, offsets, found, (step, rays), half=crossing, half_variance=0.0)


def _eroded(mask: np.ndarray) -> np.ndarray:
    """Rays with all neighbours in the mask: a shaft's rim spoils the rays beside it."""
    wide = np.concatenate([mask[-_SPOILED:], mask, mask[:_SPOILED]]).view(np.uint8)
    return cv2.erode(wide[None], _NEIGHBOURS)[0, _SPOILED:-_SPOILED].view(bool)


def _sharpened(levels: Levels, band: Band, slope: np.ndarray, doubt: float) -> Levels:
    """The levels with what the band shows better: the edge's width, the plateau and its slope."""
    width = band.width(levels)
    inner = int(np.count_nonzero(band.from_edge < -_PLATEAU * width))
    if inner == 0 or not width > 0:
        return replace(levels, width=width)
    radii = 1 + band.from_edge[:inner]
    left = _left_by_blur(levels, width, radii)
    light = float(band.mean[:inner].sum()) - levels.background * float((1 - left).sum())
    peak = light / float(levels.share_of_peak(radii) @ left)
    if not peak > levels.background:
        return levels
    rise = math.hypot(*slope) * max(1 - _BRIGHTEST_INSIDE * width, 0.0)
    peak += rise * (peak - levels.background)
    return replace(levels, width=width, peak=peak, variance=levels.variance + doubt)


def _slope(band: Band, found: np.ndarray, width: float) -> tuple[np.ndarray, float]:
    """Slope of the light across the plateau, over its mean per radius, (2,), and its variance.

    A beam that meets the wall obliquely is brighter on the near side. Texture is uneven, too, so
    the slope counts only as far as it exceeds what shorter waves explain (the garrote of Breiman
    1995).
    """
    # The sharper the edge, the less a slope of the light moves it, and a wrong guess must not.
    counts = min(max(width / _SLOPE_SHOWS - 1, 0.0), 1.0)
    if counts == 0:
        return np.zeros(2), 0.0
    waves = np.where(found[:, None], _SLOPES, 0.0)
    _, fitted = cv2.solve(waves.T @ waves, waves.T @ band.gain[:, None].astype(float))
    slope = fitted[1:, 0] / fitted[0, 0]
    square = float(slope @ slope)
    rest = np.where(found, band.gain, 0.0) - waves @ fitted[:, 0]
    variance = _DOUBTED * 2 * ring_variance(rest, slice(2, 7)) / RAYS
    kept = counts * max(0.0, 1 - variance / square) if square > 0 else 0.0
    return kept * slope, kept * variance + kept * (1 - kept) * square


def _left_by_blur(levels: Levels, width: float, radii: np.ndarray) -> np.ndarray:
    """What a Gaussian blur leaves of a plateau, at radii inside 1, where half of the peak is."""
    rim = float(levels.share_of_peak(np.ones(1))[0]) * levels.peak - levels.background
    height = min(max(rim / levels.amplitude, 0.51), 1.0)
    middle = _NORMAL.inv_cdf(0.5 / height)
    return np.array([_NORMAL.cdf(middle + (1 - r) / (width * height)) for r in radii.tolist()])
