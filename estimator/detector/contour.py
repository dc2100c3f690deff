"""The half-maximum contour of a region: which light it is fitted to, and through which ellipse.

`edges` fits a contour to a patch of light. Here the light is chosen: the wall's texture is taken
out of a broad flank, and a background that the window does not show is taken from the whole frame.
Both are known only after a fit, so such a contour is fitted again.
"""

from __future__ import annotations

import math

import numpy as np

from estimator.detector.coarse import Candidate, Coarse
from estimator.detector.edges import EdgeFit, fit_edge
from estimator.detector.ellipse import Ellipse
from estimator.detector.hollow import hollow_share
from estimator.detector.regions import Region, coarse_window
from estimator.detector.texture import without_texture
from estimator.detector.tuning import RAYS, Capture, Hollow, Refine
from estimator.detector.unwrap import Patch
from estimator.image import NoSpot, Reason, Window


def contour_of(region: Region) -> EdgeFit | NoSpot:
    """The region's contour; of several candidates the one of which most is visible."""
    best: EdgeFit | None = None
    failure = NoSpot(Reason.NONE_FOUND)
    for candidate in region.candidates:
        fit = _fitted(region, candidate)
        if isinstance(fit, NoSpot):
            failure = fit
            continue
        if best is None or np.count_nonzero(fit.inliers) > np.count_nonzero(best.inliers):
            best = fit
        if np.count_nonzero(best.inliers) > region.settings.min_coverage * RAYS:
            break
    return failure if best is None else best


def patch_round(region: Region, ellipse: Ellipse, width: float = 0.0) -> Patch:
    """Light round an ellipse; for a broad edge (`width` in radii) without the wall's texture."""
    frame, meter = region.frame, region.settings.meter
    half_width, half_height = ellipse.half_extent()
    x, y = ellipse.centre.tolist()
    window = Window.around(x, y, Capture.REACH * half_width, Capture.REACH * half_height, frame)
    values, full_scale = window.of(frame), region.full_scale
    light = meter.light(values, window, region.channel, full_scale)
    ceiling, clipped = math.inf, region.saturated[region.channel]
    if clipped > 0:
        ceiling = meter.ceiling(window, region.channel, region.clips, full_scale)
    patch = Patch(light, window.x0, window.y0, ceiling=ceiling, clipped=clipped)
    if width > Refine.BROAD and _colours_show_texture(region):
        return without_texture(patch, meter.response.light(values, full_scale), ellipse)
    return patch


def _fitted(region: Region, candidate: Candidate) -> EdgeFit | NoSpot:
    patch = patch_round(region, candidate.ellipse)
    fit = fit_edge(patch, region.coarse, candidate)
    if fit and fit.levels.width > Refine.BROAD and _colours_show_texture(region):
        even = patch_round(region, candidate.ellipse, fit.levels.width)
        if again := fit_edge(even, region.coarse, candidate):
            patch, fit = even, again
    if fit and not fit.levels.sees_background:
        fit = fit_edge(patch, _whole_frame(region), candidate)
    return NoSpot(Reason.NONE_FOUND) if fit and _is_hollow(patch, fit) else fit


def _is_hollow(patch: Patch, fit: EdgeFit) -> bool:
    """Whether an ellipse is dark behind a visible edge, as letters are."""
    levels = fit.levels
    if levels.width > Refine.BROAD:
        return False
    lit = fit.seen & ~fit.shaded
    return hollow_share(patch, fit.ellipse, lit, levels.half, levels.width) > Hollow.SHARE


def _colours_show_texture(region: Region) -> bool:
    """Whether the wall's texture is still in the frame, and no colour of it is saturated."""
    coloured = region.frame.ndim == 3 and max(region.saturated) == 0
    return coloured and region.settings.reference is None


def _whole_frame(region: Region) -> Coarse:
    settings, whole = region.settings, Window.whole(region.frame)
    values = whole.of(region.frame, settings.stride)
    return coarse_window(values, whole, region.channel, settings, region.full_scale)
