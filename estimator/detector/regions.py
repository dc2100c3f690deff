"""Sub-pixel mode at work: bright regions of a window, the channel to take, the spot they hold."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np

from estimator.detector.broad import BROAD
from estimator.detector.coarse import Candidate, Coarse, TooSmall, bright_regions
from estimator.detector.edges import REACH, EdgeFit, fit_edge
from estimator.detector.ellipse import Ellipse, covariance_of_axes, refitted
from estimator.detector.levels import dark_radius
from estimator.detector.motion_blur import SMEARED, at_mid_exposure
from estimator.detector.reflex import bears_spot
from estimator.detector.settings import SubpixelSettings
from estimator.detector.texture import without_texture
from estimator.detector.unwrap import RAYS, Patch, contour_points, shares_of_contour
from estimator.image import GREY, GREY_WEIGHTS, NoSpot, Reason, Spot, Window

_SATURATED = 0.02  # fraction of a spot's pixels at full scale that its half level notices
_BRIGHTER = 1.2  # than grey: from there a channel's weaker texture is worth its noise
_FAINTEST_CHANNEL = 0.1  # of full scale: least level of a channel that may stand in for grey
_SAME_EDGE = 0.5  # edge widths from the ellipse within which an edge is the spot's
_ROUGHEST = 0.05  # scatter of sharp edges, in units of the radius, of what is an ellipse
_VAGUEST = 0.006  # standard error of a sharp edge's size, of what is an ellipse seen in part ...
_WHOLE = 0.96  # ... rather than whole, to this fraction of its contour
_SHORTEST_ARC = 0.3  # fraction of a contour that makes an ellipse recognisable
_FILLED = 0.75  # of its ellipse's area: what takes less is cut by something
_SMALLEST_AREA = 0.7  # of the smallest spot's: a region may be only the bright part of its spot
_AROUND = 0.6  # radii of the last contour beyond where its background begins that are looked at
_LIKE_LAST = 0.5  # relative difference of areas up to which a region may be the last spot's ...
_UNHIDDEN = 0.1  # ... and up to which its centroid is the spot's centre


class Sighting(NamedTuple):
    """A spot and the contour that it was told from.

    Attributes:
        spot: what was measured.
        fit: half-maximum contour.
        channel: that it is seen in: 0, 1, 2 or `frames.GREY`.
    """

    spot: Spot
    fit: EdgeFit
    channel: int


@dataclass(frozen=True, eq=False)
class Region:
    """A bright region of a frame that may be a spot.

    Attributes:
        frame: that it was found in.
        settings: that it was found with.
        coarse: the window that it was found in, in the channel that it is to be measured in.
        channel: 0, 1, 2 or `frames.GREY`.
        saturated: fraction of its pixels at full scale, by channel; in grey the worst channel's.
        readings: ellipses that it may be a part of, one at least.
    """

    frame: np.ndarray
    settings: SubpixelSettings
    coarse: Coarse
    channel: int
    saturated: tuple[float, ...]
    readings: list[Candidate]

    @property
    def area_px(self) -> float:
        """Number of the frame's pixels in the region."""
        return float(np.count_nonzero(self.readings[0].mask)) * self.coarse.stride**2

    def measured(self) -> Sighting | NoSpot:
        """The region's spot, if its contour is one."""
        contour = self.contour()
        if isinstance(contour, NoSpot):
            return contour
        fit = contour
        if fit.levels.width > SMEARED:
            fit = at_mid_exposure(self._patch(fit.ellipse, fit.levels.width), fit)
        spot = _verdict(fit, self.settings, self.saturated[self.channel])
        if isinstance(spot, NoSpot):
            return spot
        smallest = self.settings.min_semi_minor_px
        if fit.levels.width > BROAD and bears_spot(self._patch(fit.ellipse), fit, smallest):
            return NoSpot(Reason.AMBIGUOUS)
        return Sighting(spot, contour, self.channel)

    def contour(self) -> EdgeFit | NoSpot:
        """The region's contour, through the reading of which the most of it is seen."""
        best: EdgeFit | None = None
        failure = NoSpot(Reason.NONE_FOUND)
        for candidate in self.readings:
            fit = self._fit(candidate)
            if isinstance(fit, NoSpot):
                failure = fit
                continue
            if best is None or np.count_nonzero(fit.inliers) > np.count_nonzero(best.inliers):
                best = fit
            if np.count_nonzero(best.inliers) > self.settings.min_coverage * RAYS:
                break
        if best is not None:
            return best
        if failure.reason is Reason.NONE_FOUND and self._fills_its_ellipse() < _FILLED:
            return NoSpot(Reason.OCCLUDED)
        return failure

    def _fills_its_ellipse(self) -> float:
        """Part of the ellipse round the region that the region takes."""
        semi_major, semi_minor, _ = self.readings[0].ellipse.axes()
        return self.area_px / (math.pi * semi_major * semi_minor)

    def _fit(self, candidate: Candidate) -> EdgeFit | NoSpot:
        patch = self._patch(candidate.ellipse)
        fit = fit_edge(patch, self.coarse, candidate)
        if fit and fit.levels.width > BROAD and self._tells_texture:
            even = self._patch(candidate.ellipse, fit.levels.width)
            if again := fit_edge(even, self.coarse, candidate):
                patch, fit = even, again
        if isinstance(fit, NoSpot) or fit.levels.sees_background:
            return fit
        # The window does not show the background of a bell; the frame may.
        whole = Window.whole(self.frame)
        values = whole.of(self.frame, self.settings.stride)
        full_scale = self.settings.response.full_scale_of(self.frame)
        coarse = _coarse(values, whole, self.channel, self.settings, full_scale)
        return fit_edge(patch, coarse, candidate)

    @property
    def _tells_texture(self) -> bool:
        """Whether the wall's texture is still in the frame and its colours are all there."""
        colours = self.frame.ndim == 3 and max(self.saturated) == 0
        return colours and self.settings.reference is None

    def _patch(self, ellipse: Ellipse, width: float = 0.0) -> Patch:
        """Light round an ellipse, of a broad edge (`width` in radii) without the wall's texture."""
        half_width, half_height = ellipse.half_extent()
        x, y = ellipse.centre.tolist()
        window = Window.around(x, y, REACH * half_width, REACH * half_height, self.frame)
        meter = self.settings.meter
        full_scale = meter.response.full_scale_of(self.frame)
        values = window.of(self.frame)
        light = meter.light(values, window, self.channel, full_scale)
        ceiling = math.inf
        if self.saturated[self.channel] > 0:
            ceiling = meter.ceiling(window, self.channel, full_scale)
        patch = Patch(light, window.x0, window.y0, ceiling=ceiling)
        if width > BROAD and self._tells_texture:
            return without_texture(patch, meter.response.light(values, full_scale), ellipse)
        return patch


def regions_in(
    frame: np.ndarray, window: Window, settings: SubpixelSettings
) -> Iterator[Region | NoSpot]:
    """Bright regions of a window, brightest first, and the reasons why others are none.

    Args:
        frame: checked (`frames.checked_frame`).
        window: where to look for a spot's body; its edge is followed beyond.
        settings: of the mode.
    """
    window = window.on_grid(settings.stride)
    values = window.of(frame, settings.stride)
    if min(values.shape[:2]) < 5:
        return
    full_scale = settings.response.full_scale_of(frame)
    settings.meter.check(frame)
    grey = _coarse(values, window, GREY, settings, full_scale)
    smallest = _SMALLEST_AREA * math.pi * settings.min_semi_minor_px**2
    for readings in bright_regions(grey, min_contrast=settings.min_contrast, min_area=smallest):
        if isinstance(readings, TooSmall):
            yield NoSpot(Reason.TOO_SMALL)
        elif readings:
            mask = readings[0].mask.view(np.uint8)
            channel, saturated = _channel(values, mask, full_scale)
            coarse = grey
            if channel != GREY:
                coarse = _coarse(values, window, channel, settings, full_scale)
                readings = [candidate.relevelled(coarse) for candidate in readings]
            yield Region(frame, settings, coarse, channel, saturated, readings)


def region_of(last: Sighting, frame: np.ndarray, settings: SubpixelSettings) -> Region | None:
    """The region that the spot of the frame before takes in this one.

    It is what exceeds the half level near the last contour.

    Args:
        last: in the frame before.
        frame: checked (`frames.checked_frame`).
        settings: of the mode.

    Returns:
        None where nothing like it is there, where another channel shows it better now, and for a
        broad edge, whose background is too far away to be looked for nearby.
    """
    ellipse, levels, stride = last.fit.ellipse, last.fit.levels, settings.stride
    if levels.width > BROAD:
        return None
    settings.meter.check(frame)
    half_width, half_height = ellipse.scaled(dark_radius(levels.width) + _AROUND).half_extent()
    x, y = ellipse.centre.tolist()
    window = Window.around(x, y, half_width, half_height, frame).on_grid(stride)
    values = window.of(frame, stride)
    full_scale = settings.response.full_scale_of(frame)
    coarse = _coarse(values, window, last.channel, settings, full_scale)
    mask = (coarse.levels > levels.half / coarse.unit).view(np.uint8)
    moments = cv2.moments(mask, binaryImage=True)
    semi_major, semi_minor, _ = ellipse.axes()
    filled = moments["m00"] * stride**2 / (math.pi * semi_major * semi_minor)
    if abs(filled - 1) > _LIKE_LAST:
        return None
    channel, saturated = _channel(values, mask, full_scale)
    if channel != last.channel:
        return None
    if abs(filled - 1) < _UNHIDDEN:
        centroid = np.array([moments["m10"], moments["m01"]]) / moments["m00"]
        ellipse = Ellipse((window.x0, window.y0) + stride * centroid, ellipse.shape)
    candidate = Candidate(ellipse, 0.0, 0.0, mask.view(bool))
    return Region(frame, settings, coarse, channel, saturated, [candidate.relevelled(coarse)])


def _coarse(
    values: np.ndarray,
    window: Window,
    channel: int,
    settings: SubpixelSettings,
    full_scale: float,
) -> Coarse:
    stride = settings.stride
    light = settings.meter.light(values, window, channel, full_scale, stride)
    return Coarse.of_signal(light, stride=stride, x0=window.x0, y0=window.y0)


def _channel(
    values: np.ndarray, mask: np.ndarray, full_scale: float
) -> tuple[int, tuple[float, ...]]:
    """The channel to measure the masked region in, and `Region.saturated`."""
    _, full = cv2.threshold(values, full_scale * (1 - 1e-6), 1, cv2.THRESH_BINARY)
    saturated = cv2.mean(full, mask)[:3]
    if values.ndim == 2:
        return GREY, saturated[:1]
    peaks = cv2.mean(values, mask)[:3]
    fractions = (*saturated, max(saturated))
    usable = [k for k in range(3) if peaks[k] > _FAINTEST_CHANNEL * full_scale] or [0, 1, 2]
    # What saturates every channel is a glint, and no channel is better off.
    least = min(saturated[k] for k in usable)
    unspoilt = [k for k in usable if saturated[k] <= least + _SATURATED]
    brightest = max(unspoilt, key=lambda k: peaks[k])
    grey = sum(weight * peak for weight, peak in zip(GREY_WEIGHTS, peaks, strict=True))
    if len(unspoilt) < len(usable) or peaks[brightest] > _BRIGHTER * grey:
        return brightest, fractions
    return GREY, fractions


def _verdict(fit: EdgeFit, settings: SubpixelSettings, saturated: float) -> Spot | NoSpot:
    semi_major, semi_minor, angle = fit.ellipse.axes()
    levels = fit.levels
    # What texture roughens is seen all the same, if it is not where nothing of the edge can be.
    seen = fit.inliers | (fit.found & (np.abs(fit.offsets) < _SAME_EDGE * levels.width))
    coverage, belonging, in_frame = shares_of_contour(fit.ellipse, seen, fit.inliers, fit.inside)
    coherent = fit.scatter < _ROUGHEST * (1 + levels.width / BROAD)
    if not coherent or belonging < _SHORTEST_ARC:
        return NoSpot(Reason.NONE_FOUND)
    if semi_major > settings.max_axis_ratio * semi_minor:
        return NoSpot(Reason.NONE_FOUND)
    if levels.amplitude < settings.min_contrast * levels.background:
        return NoSpot(Reason.NONE_FOUND)
    if semi_minor < settings.min_semi_minor_px:
        return NoSpot(Reason.TOO_SMALL)
    if semi_major > settings.max_semi_major_px:
        return NoSpot(Reason.TOO_LARGE)
    if coverage < settings.min_coverage:
        return NoSpot(Reason.CLIPPED if in_frame < settings.min_coverage else Reason.OCCLUDED)
    ellipse = fit.ellipse
    if settings.camera is not None:
        edges = contour_points(ellipse, fit.offsets)[fit.inliers]
        ellipse = refitted(ellipse, settings.camera.undistorted(edges))
        semi_major, semi_minor, angle = ellipse.axes()
    covariance = covariance_of_axes(ellipse, fit.step_covariance)
    vague = covariance[3, 3] > (_VAGUEST * semi_minor) ** 2
    if vague and coverage < _WHOLE and levels.width < BROAD:
        return NoSpot(Reason.OCCLUDED)
    x, y = ellipse.centre.tolist()
    return Spot(
        x_px=x,
        y_px=y,
        semi_major_px=semi_major,
        semi_minor_px=semi_minor,
        angle_rad=angle,
        covariance=covariance,
        edge_width_px=levels.width * math.sqrt(semi_major * semi_minor),
        coverage=coverage,
        inlier_fraction=float(np.count_nonzero(fit.inliers) / max(fit.found.sum(), 1)),
        saturated=saturated,
    )
