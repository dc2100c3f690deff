"""The colour channel in which a region of a frame is measured."""

from __future__ import annotations

import cv2
import numpy as np

from estimator.detector.tuning import Channel
from estimator.image import GREY, GREY_WEIGHTS


def channel_for(
    values: np.ndarray, mask: np.ndarray, full_scale: float
) -> tuple[int, tuple[float, ...]]:
    """The channel with the least noise and texture that is not saturated.

    This is grey, the weighted mean of the colours, unless a channel is clearly brighter in the
    region (its texture is weaker) or saturated.

    Args:
        values: of the window, grey or RGB.
        mask: (h, w) uint8, 1 in the region.
        full_scale: of the values.

    Returns:
        0, 1, 2 or GREY; and the fraction of the region's pixels at full scale by channel, the last
        entry the worst channel's, so that GREY as an index selects it.
    """
    _, full = cv2.threshold(values, full_scale * (1 - 1e-6), 1, cv2.THRESH_BINARY)
    saturated = cv2.mean(full, mask)[:3]
    if values.ndim == 2:
        return GREY, saturated[:1]
    peaks = cv2.mean(values, mask)[:3]
    fractions = (*saturated, max(saturated))
    usable = [k for k in range(3) if peaks[k] > Channel.FAINTEST * full_scale] or [0, 1, 2]
    # A glint saturates every channel, so only what exceeds the least saturated channel counts.
    least = min(saturated[k] for k in usable)
    unspoilt = [k for k in usable if saturated[k] <= least + Channel.SATURATED]
    brightest = max(unspoilt, key=lambda k: peaks[k])
    grey = sum(weight * peak for weight, peak in zip(GREY_WEIGHTS, peaks, strict=True))
    if len(unspoilt) < len(usable) or peaks[brightest] > Channel.BRIGHTER * grey:
        return brightest, fractions
    return GREY, fractions
