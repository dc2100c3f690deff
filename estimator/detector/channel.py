"""The colour channel in which a region of a frame is measured, and where its values end."""

from __future__ import annotations

import math

import cv2
import numpy as np

from estimator.detector.tuning import Channel
from estimator.image import GREY, GREY_WEIGHTS, Window, clip_level

_HOT = 0.005  # share of a region's pixels that may be hot, or written over


def channel_for(
    frame: np.ndarray, window: Window, stride: int, mask: np.ndarray, full_scale: float
) -> tuple[int, tuple[float, ...], tuple[float, ...]]:
    """The channel with the least noise and texture that is not saturated.

    This is grey, the weighted mean of the colours, unless a channel is clearly brighter in the
    region (its texture is weaker) or saturated.

    Args:
        frame: grey or RGB.
        window: of the frame.
        stride: px of the frame per pixel of the mask.
        mask: (h, w) uint8 of the window, 1 in the region.
        full_scale: of the frame.

    Returns:
        0, 1, 2 or GREY; the value at which each channel is clipped (`clip_level`, or full scale);
        and the fraction of the region's pixels that are, by channel, the last entry the worst
        channel's, so that GREY as an index selects it.
    """
    values = window.of(frame, stride)
    planes = [values] if values.ndim == 2 else cv2.split(values)
    shown = mask.view(bool)
    clips, saturated = [], []
    for number, plane in enumerate(planes):
        clip = full_scale
        if _may_be_clipped(plane[shown]):
            clip = min(clip_level(*_part(frame, window, stride, mask, number)), full_scale)
        _, full = cv2.threshold(plane, clip * (1 - 1e-6), 1, cv2.THRESH_BINARY)
        clips.append(clip)
        saturated.append(cv2.mean(full, mask)[0])
    if len(planes) == 1:
        return GREY, tuple(clips), tuple(saturated)
    peaks = cv2.mean(values, mask)[:3]
    usable = [k for k in range(3) if peaks[k] > Channel.FAINTEST * max(peaks)] or [0, 1, 2]
    # A glint saturates every channel, so only what exceeds the least saturated channel counts.
    least = min(saturated[k] for k in usable)
    unspoilt = [k for k in usable if saturated[k] <= least + Channel.SATURATED]
    brightest = max(unspoilt, key=lambda k: peaks[k])
    grey = sum(weight * peak for weight, peak in zip(GREY_WEIGHTS, peaks, strict=True))
    channel = GREY
    if len(unspoilt) < len(usable) or peaks[brightest] > Channel.BRIGHTER * grey:
        channel = brightest
    return channel, tuple(clips), (*saturated, max(saturated))


def _may_be_clipped(bright: np.ndarray) -> bool:
    """Whether as many pixels have a region's largest value, but for hot ones, as the next three.

    The whole region is looked at only if these few pixels allow it: noise has fewer at its end.
    """
    seen = np.sort(bright)
    level = seen[-1 - int(_HOT * seen.size)]
    first, end = np.searchsorted(seen, level), np.searchsorted(seen, level, side="right")
    most = int(end - first + 2.0 * math.sqrt(end - first))
    beside = seen[max(first - 3 * most - 1, 0) : first]
    return bool(end - first > 1 and not np.any(beside[most:] == beside[:-most]))


def _part(
    frame: np.ndarray, window: Window, stride: int, mask: np.ndarray, channel: int
) -> tuple[np.ndarray, np.ndarray]:
    """A channel of the region's bounding box, and which pixels are the region's, both (h, w)."""
    x, y, width, height = cv2.boundingRect(mask)
    # All pixels show a flat top; every stride-th one is enough of a large region.
    every = stride if width * height * stride**2 > Channel.MOST_PX else 1
    x0, y0 = window.x0 + x * stride, window.y0 + y * stride
    part = frame[y0 : y0 + height * stride : every, x0 : x0 + width * stride : every]
    part = part if part.ndim == 2 else part[:, :, channel]
    bright = cv2.resize(
        mask[y : y + height, x : x + width], part.shape[1::-1], interpolation=cv2.INTER_NEAREST
    )
    return part, bright.view(bool)
