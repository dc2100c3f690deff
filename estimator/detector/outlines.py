"""Where the spot may be in a frame in which none was measured."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from estimator.detector.ellipse import Ellipse
from estimator.detector.regions import Region, regions_in
from estimator.detector.settings import SubpixelSettings
from estimator.detector.tracking import TrackState, measure
from estimator.detector.tuning import Faint
from estimator.detector.verdict import spot_on_reflection
from estimator.image import NoSpot, Outline, Reason, Spot, Window, checked_frame


def outlines_of(
    frame: np.ndarray, result: Spot | NoSpot, settings: SubpixelSettings
) -> list[Outline]:
    """The outline of the spot, even if it is faint or seen in part, or those of whatever is bright.

    Args:
        frame: as `measure` takes it.
        result: what was measured in it.
        settings: with which it was measured.
    """
    if isinstance(result, Spot):
        return [result.outline]
    frame = checked_frame(frame)
    settings = replace(
        settings,
        min_contrast=min(settings.min_contrast, Faint.CONTRAST),
        min_coverage=min(settings.min_coverage, Faint.COVERAGE),
    )
    if result.reason in (Reason.NONE_FOUND, Reason.OCCLUDED, Reason.CLIPPED):
        fainter, _ = measure(frame, TrackState(), settings)
        if isinstance(fainter, Spot):
            return [fainter.outline]
    if result.reason in (Reason.AMBIGUOUS, Reason.OCCLUDED):
        on_reflections = _outlines_on_reflections(frame, settings)
        if on_reflections:
            return on_reflections
    return _bright_outlines(frame, settings, measured=result.reason is Reason.SATURATED)


def _outlines_on_reflections(frame: np.ndarray, settings: SubpixelSettings) -> list[Outline]:
    """Spots on a wet wall's reflections of a lamp."""
    found = []
    for region in regions_in(frame, Window.whole(frame), settings):
        fit = spot_on_reflection(region) if isinstance(region, Region) else None
        if fit is not None:
            outline = _outline(fit.ellipse)
            size = math.sqrt(outline.semi_major_px * outline.semi_minor_px)
            found.append(outline._replace(edge_width_px=fit.levels.width * size))
    return found


def _bright_outlines(
    frame: np.ndarray, settings: SubpixelSettings, *, measured: bool
) -> list[Outline]:
    """Ellipses round the bright regions of a frame that fill theirs, good to a few px."""
    found = []
    for region in regions_in(frame, Window.whole(frame), settings):
        if isinstance(region, Region) and region.fills_its_ellipse() > Faint.FILLED:
            outline = _outline(region.ellipse)
            if (
                outline.semi_minor_px > settings.min_semi_minor_px
                and outline.semi_major_px < settings.max_semi_major_px
            ):
                found.append(outline._replace(measured=measured))
    return found


def _outline(ellipse: Ellipse) -> Outline:
    x, y = ellipse.centre.tolist()
    return Outline(x, y, *ellipse.axes())
