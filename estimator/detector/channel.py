"""The colour channel in which a region of a frame is measured, and where its values end."""

from __future__ import annotations

import cv2
import numpy as np

from estimator.detector.tuning import Channel
from estimator.image import GREY, GREY_WEIGHTS, Window, clip_level


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
    x, y, width, height = cv2.boundingRect(mask)
    # All pixels show a flat top; every stride-th one is enough of a large region.
    every = stride if width * height * stride**2 > Channel.MOST_PX else 1
    x0, y0 = window.x0 + x * stride, window.y0 + y * stride
    part = frame[y0 : y0 + height * stride : every, x0 : x0 + width * stride : every]
    bright = mask[y : y + height, x : x + width]
    bright = cv2.resize(bright, part.shape[1::-1], interpolation=cv2.INTER_NEAREST)
    channels = [part] if part.ndim == 2 else cv2.split(part)
    shown = bright.view(bool)
    clips = tuple(min(clip_level(values, shown), full_scale) for values in channels)
    number = max(cv2.countNonZero(bright), 1)
    saturated = [
        float(np.count_nonzero(values[shown] >= clip * (1 - 1e-6))) / number
        for values, clip in zip(channels, clips, strict=True)
    ]
    if len(channels) == 1:
        return GREY, clips, (saturated[0],)
    peaks = [cv2.mean(values, bright)[0] for values in channels]
    usable = [k for k in range(3) if peaks[k] > Channel.FAINTEST * max(peaks)] or [0, 1, 2]
    # A glint saturates every channel, so only what exceeds the least saturated channel counts.
    least = min(saturated[k] for k in usable)
    unspoilt = [k for k in usable if saturated[k] <= least + Channel.SATURATED]
    brightest = max(unspoilt, key=lambda k: peaks[k])
    grey = sum(weight * peak for weight, peak in zip(GREY_WEIGHTS, peaks, strict=True))
    channel = GREY
    if len(unspoilt) < len(usable) or peaks[brightest] > Channel.BRIGHTER * grey:
        channel = brightest
    return channel, clips, (*saturated, max(saturated))
