"""Bright regions of a frame that may be the spot: anywhere in a window, or at the last contour."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np

from estimator.detector.channel import channel_for
from estimator.detector.coarse import Candidate, Coarse, TooSmall, bright_regions
from estimator.detector.edges import EdgeFit
from estimator.detector.ellipse import Ellipse
from estimator.detector.levels import dark_radius
from estimator.detector.settings import SubpixelSettings
from estimator.detector.tuning import Refine, Search
from estimator.image import GREY, NoSpot, Reason, Window


@dataclass(frozen=True, eq=False)
class Region:
    """A bright region of a frame that may be a spot.

    Attributes:
        frame: in which it was found.
        settings: with which it was found.
        coarse: the window in which it was found, in the channel in which it is to be measured.
        channel: 0, 1, 2 or GREY.
        full_scale: of the frame.
        clips: value at which each channel is clipped, see `channel_for`.
        saturated: fraction of its pixels that are clipped by channel, see `channel_for`.
        candidates: at least one ellipse of which it may be a part.
        faint: whether it is no brighter than a wall's texture may make it.
    """

    frame: np.ndarray
    settings: SubpixelSettings
    coarse: Coarse
    channel: int
    full_scale: float
    clips: tuple[float, ...]
    saturated: tuple[float, ...]
    candidates: list[Candidate]
    faint: bool

    @property
    def area_px(self) -> float:
        """Number of the frame's pixels in the region."""
        return float(np.count_nonzero(self.candidates[0].mask)) * self.coarse.stride**2

    @property
    def ellipse(self) -> Ellipse:
        """The ellipse round the region, good to a few px."""
        return self.candidates[0].ellipse

    def fills_its_ellipse(self) -> float:
        """Fraction of the ellipse round the region that the region takes up."""
        semi_major, semi_minor, _ = self.ellipse.axes()
        return self.area_px / (math.pi * semi_major * semi_minor)


def regions_in(
    frame: np.ndarray, window: Window, settings: SubpixelSettings
) -> Iterator[Region | NoSpot]:
    """Bright regions of a window, brightest first, and the reasons why others are no spots.

    Args:
        frame: checked (`image.checked_frame`).
        window: where the spot's body may lie; its edge is followed beyond.
        settings: of the mode.
    """
    window = window.on_grid(settings.stride)
    values = window.of(frame, settings.stride)
    if min(values.shape[:2]) < Search.SMALLEST_WINDOW:
        return
    full_scale = settings.response.full_scale_of(frame)
    settings.meter.check(frame)
    grey = coarse_window(values, window, GREY, settings, full_scale)
    smallest = Search.SMALLEST_AREA * math.pi * settings.min_semi_minor_px**2
    for candidates in bright_regions(grey, min_contrast=settings.min_contrast, min_area=smallest):
        if isinstance(candidates, TooSmall):
            yield NoSpot(Reason.TOO_SMALL)
        elif candidates:
            mask = candidates[0].mask.view(np.uint8)
            channel, clips, full = channel_for(frame, window, settings.stride, mask, full_scale)
            coarse, faint = grey, candidates[0].is_below(settings.min_contrast)
            if channel != GREY:
                coarse = coarse_window(values, window, channel, settings, full_scale)
                candidates = [candidate.relevelled(coarse) for candidate in candidates]
            yield Region(
                frame, settings, coarse, channel, full_scale, clips, full, candidates, faint
            )


def region_at(
    last: EdgeFit, channel: int, frame: np.ndarray, settings: SubpixelSettings
) -> Region | None:
    """The region that exceeds the last spot's half level near its contour.

    Args:
        last: the spot's contour in the last frame.
        channel: in which it was measured.
        frame: checked (`image.checked_frame`).
        settings: of the mode.

    Returns:
        None where there is nothing like it, where another channel shows it better now, and for a
        broad edge, whose background is too far away for a search nearby.
    """
    ellipse, levels, stride = last.ellipse, last.levels, settings.stride
    if levels.width > Refine.BROAD:
        return None
    settings.meter.check(frame)
    reach = dark_radius(levels.width) + Search.AROUND
    x, y = ellipse.centre.tolist()
    window = Window.around(x, y, *ellipse.scaled(reach).half_extent(), frame).on_grid(stride)
    values = window.of(frame, stride)
    full_scale = settings.response.full_scale_of(frame)
    coarse = coarse_window(values, window, channel, settings, full_scale)
    mask = (coarse.levels > levels.half / coarse.unit).view(np.uint8)
    moments = cv2.moments(mask, binaryImage=True)
    semi_major, semi_minor, _ = ellipse.axes()
    filled = moments["m00"] * stride**2 / (math.pi * semi_major * semi_minor)
    if abs(filled - 1) > Search.LIKE_LAST:
        return None
    best_channel, clips, full = channel_for(frame, window, stride, mask, full_scale)
    if best_channel != channel:
        return None
    if abs(filled - 1) < Search.UNHIDDEN:
        centroid = np.array([moments["m10"], moments["m01"]]) / moments["m00"]
        ellipse = Ellipse((window.x0, window.y0) + stride * centroid, ellipse.shape)
    candidate = Candidate(ellipse, 0.0, 0.0, mask.view(bool)).relevelled(coarse)
    faint = candidate.is_below(settings.min_contrast)
    return Region(frame, settings, coarse, channel, full_scale, clips, full, [candidate], faint)


def coarse_window(
    values: np.ndarray,
    window: Window,
    channel: int,
    settings: SubpixelSettings,
    full_scale: float,
) -> Coarse:
    """The light of a window in one channel, subsampled and in 8 bits.

    Args:
        values: of the window, every `settings.stride`-th pixel.
        window: of a checked frame.
        channel: 0, 1, 2 or GREY.
        settings: of the mode.
        full_scale: of the frame.
    """
    stride = settings.stride
    light = settings.meter.light(values, window, channel, full_scale, stride)
    return Coarse.of_signal(light, stride=stride, x0=window.x0, y0=window.y0)
