"""Sub-pixel mode: the half-maximum contour of the linearised signal.

The edge of a spot is where its light, the wall's reflectance taken out, falls to the middle between
the spot's own peak (of a bell) or plateau (of a disc, domed or flat) and the background around it.
It does not move with exposure nor, where the edge is symmetric about its middle, with blur.

Colour frames are measured on their grey mean (the weights of cv2's RGB2GRAY), which has the least
noise, unless one channel is clearly brighter in the spot, where texture is weaker (on a retina red,
in which vessels hardly show), or a channel is saturated: then on the least saturated one.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field

import cv2
import numpy as np

from .coarse import Candidate, Coarse, TooSmall, bright_regions
from .edges import REACH, EdgeFit, fit_edge
from .ellipse import Ellipse, covariance_of_axes
from .frames import GREY, GREY_WEIGHTS, Response, Window, signal_of
from .spot import NoSpot, Reason, Spot
from .unwrap import Patch, share_of_contour

_SATURATED = 0.02  # fraction of a spot's pixels at full scale that its half level notices
_GREY_GAIN = (
    1.2  # brightness over grey from which one channel is taken: least texture for its noise
)
_FAINTEST_CHANNEL = 0.1  # of full scale: least peak of a channel that may stand in for grey
_ROUGHEST = 0.06  # scatter of the edges, in units of the radius, of something that is an ellipse
_SHORTEST_ARC = 0.2  # fraction of a contour from which an ellipse is recognised as hidden


@dataclass(frozen=True, kw_only=True, eq=False)
class SubpixelSettings:
    """Settings of the sub-pixel mode.

    Attributes:
        response: how values follow from light.
        search_half_width_px: half side of the square searched round the last position.
        min_semi_minor_px: smaller spots are `too_small`.
        max_semi_major_px: larger spots are `too_large`.
        max_axis_ratio: of semi-major to semi-minor; more elongated regions are no spots.
        min_contrast: least (peak - background) / background; must exceed what texture alone shows.
        min_coverage: fraction of the contour below which a spot is `occluded` or `clipped`.
        max_jump_px: furthest move between frames; a spot further away must be seen twice.
        max_growth: largest ratio of the semi-minor axes of two frames, either way.
    """

    response: Response = field(default_factory=Response)
    search_half_width_px: int = 200
    min_semi_minor_px: float = 15.0
    max_semi_major_px: float = 400.0
    max_axis_ratio: float = 3.0
    min_contrast: float = 1.0
    min_coverage: float = 0.5
    max_jump_px: float = 80.0
    max_growth: float = 1.5

    def __post_init__(self) -> None:
        """Reject settings under which nothing can be found."""
        positive = (
            "search_half_width_px",
            "min_semi_minor_px",
            "min_contrast",
            "max_jump_px",
        )
        for name in positive:
            if not getattr(self, name) > 0:
                raise ValueError(
                    f"SubpixelSettings({name}=...) must be positive; got {getattr(self, name)}."
                )
        for name in ("max_axis_ratio", "max_growth"):
            if not getattr(self, name) > 1:
                raise ValueError(
                    f"SubpixelSettings({name}=...) must exceed 1; got {getattr(self, name)}."
                )
        if not 0 < self.min_coverage <= 1:
            raise ValueError(
                f"SubpixelSettings(min_coverage=...) must lie in (0, 1]; got {self.min_coverage}."
            )
        if not self.max_semi_major_px > self.min_semi_minor_px:
            raise ValueError(
                "SubpixelSettings(max_semi_major_px=...) must exceed min_semi_minor_px; got"
                f" {self.max_semi_major_px} px and {self.min_semi_minor_px} px."
            )

    @property
    def stride(self) -> int:
        """Subsampling of the search: the smallest spot still spans seven pixels."""
        return max(1, min(4, int(self.min_semi_minor_px / 3.5)))


@dataclass(frozen=True, eq=False)
class Region:
    """A bright region of a frame that may be a spot.

    Attributes:
        frame: that it was found in.
        settings: that it was found with.
        coarse: the window that it was found in, in the channel that it is to be measured in.
        channel: 0, 1, 2 or `frames.GREY`.
        saturated: fraction of its pixels at full scale in that channel.
        readings: ellipses that it may be a part of.
    """

    frame: np.ndarray
    settings: SubpixelSettings
    coarse: Coarse
    channel: int
    saturated: float
    readings: list[Candidate]

    @property
    def area_px(self) -> float:
        """Number of the frame's pixels in the region."""
        return float(np.count_nonzero(self.readings[0].mask)) * self.coarse.stride**2

    def measured(self) -> Spot | NoSpot:
        """The region's spot, through the reading of which the most contour is seen."""
        best: EdgeFit | NoSpot = NoSpot(Reason.NONE_FOUND)
        for candidate in self.readings:
            patch = _patch(self.frame, self.channel, candidate.ellipse, self.settings)
            fit = fit_edge(patch, self.coarse, candidate)
            if isinstance(fit, NoSpot):
                best = best or fit
            elif not best or fit.inliers.sum() > best.inliers.sum():
                best = fit
            if best and best.inliers.mean() > self.settings.min_coverage:
                break
        return _verdict(best, self.settings, self.saturated) if best else best


def regions_in(
    frame: np.ndarray, window: Window, settings: SubpixelSettings
) -> Iterator[Region | NoSpot]:
    """Bright regions of a window, brightest first, and the reasons why others are none.

    Args:
        frame: checked (`frames.checked_frame`).
        window: where to look for a spot's body; its edge is followed beyond.
        settings: of the mode.
    """
    values = _subsampled(window.of(frame), settings.stride)
    if min(values.shape[:2]) < 5:
        return
    full_scale = settings.response.full_scale_of(frame)
    grey = _coarse(values, GREY, window, settings, full_scale)
    smallest = 0.7 * math.pi * settings.min_semi_minor_px**2
    for readings in bright_regions(grey, min_contrast=settings.min_contrast, min_area=smallest):
        if isinstance(readings, TooSmall):
            yield NoSpot(Reason.TOO_SMALL)
        elif readings:
            mask = readings[0].mask
            channel = _channel(values, mask, full_scale)
            saturated = _saturated_fractions(values, mask, full_scale)[channel]
            if channel == GREY:
                yield Region(frame, settings, grey, channel, saturated, readings)
            else:
                coarse = _coarse(values, channel, window, settings, full_scale)
                relevelled = [candidate.relevelled(coarse) for candidate in readings]
                yield Region(frame, settings, coarse, channel, saturated, relevelled)


def _subsampled(values: np.ndarray, stride: int) -> np.ndarray:
    if values.dtype == np.float64:
        return values[::stride, ::stride].astype(np.float32)
    height, width = values.shape[0] // stride, values.shape[1] // stride
    if min(height, width) < 1:
        return values[::stride, ::stride]
    whole = values[: height * stride, : width * stride]
    # Four times as fast as a strided copy of colour pixels.
    return cv2.resize(whole, (width, height), interpolation=cv2.INTER_NEAREST)


def _coarse(
    values: np.ndarray,
    channel: int,
    window: Window,
    settings: SubpixelSettings,
    full_scale: float,
) -> Coarse:
    signal = signal_of(values, channel, settings.response, full_scale)
    return Coarse.of_signal(signal, stride=settings.stride, x0=window.x0, y0=window.y0)


def _channel(values: np.ndarray, mask: np.ndarray, full_scale: float) -> int:
    """The channel to measure the masked region in."""
    if values.ndim == 2:
        return GREY
    peaks = cv2.mean(values, mask.view(np.uint8))[:3]
    saturated = _saturated_fractions(values, mask, full_scale)
    usable = [k for k in range(3) if peaks[k] > _FAINTEST_CHANNEL * full_scale] or [0, 1, 2]
    # What saturates every channel is a glint, and no channel is better off.
    least = min(saturated[k] for k in usable)
    unspoilt = [k for k in usable if saturated[k] <= least + _SATURATED]
    brightest = max(unspoilt, key=lambda k: peaks[k])
    grey = float(np.dot(peaks, GREY_WEIGHTS))
    if len(unspoilt) < len(usable) or peaks[brightest] > _GREY_GAIN * grey:
        return brightest
    return GREY


def _saturated_fractions(
    values: np.ndarray, mask: np.ndarray, full_scale: float
) -> tuple[float, ...]:
    """Fraction of the mask's pixels at full scale: of red, green, blue and, last, the worst."""
    _, full = cv2.threshold(values, full_scale * (1 - 1e-6), 1, cv2.THRESH_BINARY)
    fractions = cv2.mean(full, mask.view(np.uint8))
    return fractions[:1] if values.ndim == 2 else (*fractions[:3], max(fractions))


def _patch(frame: np.ndarray, channel: int, ellipse: Ellipse, settings: SubpixelSettings) -> Patch:
    half_width, half_height = ellipse.half_extent()
    x, y = ellipse.centre.tolist()
    window = Window.around(x, y, REACH * half_width, REACH * half_height, frame)
    full_scale = settings.response.full_scale_of(frame)
    signal = signal_of(window.of(frame), channel, settings.response, full_scale)
    return Patch(signal, window.x0, window.y0, ceiling=full_scale)


def _verdict(fit: EdgeFit, settings: SubpixelSettings, saturated: float) -> Spot | NoSpot:
    semi_major, semi_minor, angle = fit.ellipse.axes()
    coverage = share_of_contour(fit.ellipse, fit.inliers)
    coherent = fit.scatter < _ROUGHEST and coverage > _SHORTEST_ARC
    levels = fit.levels
    if not coherent or semi_major > settings.max_axis_ratio * semi_minor:
        return NoSpot(Reason.NONE_FOUND)
    if levels.amplitude < settings.min_contrast * levels.background:
        return NoSpot(Reason.NONE_FOUND)
    if semi_minor < settings.min_semi_minor_px:
        return NoSpot(Reason.TOO_SMALL)
    if semi_major > settings.max_semi_major_px:
        return NoSpot(Reason.TOO_LARGE)
    if coverage < settings.min_coverage:
        in_frame = share_of_contour(fit.ellipse, fit.inside)
        return NoSpot(Reason.CLIPPED if in_frame < settings.min_coverage else Reason.OCCLUDED)
    x, y = fit.ellipse.centre.tolist()
    return Spot(
        x_px=x,
        y_px=y,
        semi_major_px=semi_major,
        semi_minor_px=semi_minor,
        angle_rad=angle,
        covariance=covariance_of_axes(fit.ellipse, fit.step_covariance),
        edge_width_px=levels.width * math.sqrt(semi_major * semi_minor),
        coverage=coverage,
        inlier_fraction=float(fit.inliers.sum() / max(int(fit.found.sum()), 1)),
        saturated=saturated,
    )
