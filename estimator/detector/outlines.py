"""Outlines of bright regions, for those who look for a spot where none can be measured."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from estimator.detector.regions import Region, regions_in
from estimator.detector.settings import SubpixelSettings
from estimator.image import Outline, Window, checked_frame

_CONTRAST = 0.25
"""Least (peak - background) / background. Texture alone reaches it, but a spot under the haze of a
wet wall has no more."""
_FILLED = 0.8  # least share of the ellipse round a region


def bright_outlines(frame: np.ndarray, settings: SubpixelSettings) -> list[Outline]:
    """Ellipses round the bright regions of a frame that fill theirs, brightest first.

    They are good to a few px, and each may be something else than a spot.

    Args:
        frame: as `measure` takes it.
        settings: of the mode; regions of less contrast than it asks for are outlined, too.
    """
    frame = checked_frame(frame)
    settings = replace(settings, min_contrast=min(settings.min_contrast, _CONTRAST))
    found = []
    for region in regions_in(frame, Window.whole(frame), settings):
        if isinstance(region, Region) and region.fills_its_ellipse() > _FILLED:
            x, y = region.ellipse.centre.tolist()
            semi_major, semi_minor, angle = region.ellipse.axes()
            if semi_minor > settings.min_semi_minor_px and semi_major < settings.max_semi_major_px:
                found.append(Outline(x, y, semi_major, semi_minor, angle, measured=False))
    return found
