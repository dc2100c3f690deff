"""One refinement of a spot with a sharp edge.

The wall's reflectance is taken out of each ray, as a gain and a gradient, so that its edge is where
its own light is half.
"""

from __future__ import annotations

from dataclasses import replace
from statistics import NormalDist

import numpy as np

from .band import FURTHEST, Band, Refined
from .censored import READABLE, hidden_edge
from .ellipse import Ellipse, robust_step
from .levels import Levels
from .spot import NoSpot, Reason
from .unwrap import DESIGN, Patch

_NORMAL = NormalDist()

_REACH = 3.0  # edge widths on either side that hold all of an edge ...
_REACH_PX = 2.5  # ... and at least so many px
_MIDDLE = 0.8  # edge widths on either side of the half level that a cubic fits
_PLATEAU = 2.6  # edge widths from the edge to where its blur no longer shows
_FORGIVEN = 0.1  # edge widths that texture may move an edge
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
    levels = _sharpened(levels, band)
    crossing = band.half_crossing(levels.half, _MIDDLE * levels.width)
    if crossing is None:
        return NoSpot(Reason.NONE_FOUND)
    return band.refined(levels, offsets, found, fitted, half=crossing, half_variance=0.0)


def _eroded(mask: np.ndarray) -> np.ndarray:
    """Rays with both neighbours in the mask: a shaft's rim spoils the rays beside it."""
    wide = np.concatenate([mask[-1:], mask, mask[:1]])
    return wide[:-2] & mask & wide[2:]


def _sharpened(levels: Levels, band: Band) -> Levels:
    """The levels with what the mean profile shows better: the edge's width and its plateau."""
    width = band.width(levels)
    inner = int(np.count_nonzero(band.from_edge < -_PLATEAU * width))
    if inner == 0 or not width > 0:
        return replace(levels, width=width)
    radii = 1 + band.from_edge[:inner]
    left = _left_by_blur(levels, width, radii)
    light = float(band.mean[:inner].mean()) - levels.background * float((1 - left).mean())
    peak = light / float((levels.share_of_peak(radii) * left).mean())
    return replace(levels, width=width, peak=peak) if peak > levels.background else levels


def _left_by_blur(levels: Levels, width: float, radii: np.ndarray) -> np.ndarray:
    """What a Gaussian blur leaves of a plateau, at radii inside 1, where half of the peak is."""
    rim = float(levels.share_of_peak(np.ones(1))[0]) * levels.peak - levels.background
    height = min(max(rim / levels.amplitude, 0.51), 1.0)
    middle = _NORMAL.inv_cdf(0.5 / height)
    return np.array([_NORMAL.cdf(middle + (1 - r) / (width * height)) for r in radii.tolist()])
