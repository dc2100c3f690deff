"""Pixels of a sharp spot that a tool hides, or on which its shadow lies.

A cell in which the light of the spot ends at such a border says nothing of the spot's edge, and
before a pose is known it cannot be told from one at that edge. Pixels can: they are dark well
within the spot.
"""

from __future__ import annotations

import math

import cv2
import numpy as np
from jaxtyping import Bool, Float

from estimator.image import Outline

_DARK = 0.4
"""Of the spot's light, below which a pixel is hidden. Vessels of a retina are half as bright as the
rest at least, and a shadow has the ambient light alone."""
_BRIGHT = 0.95  # quantile of the light within the spot, a tenth of which is seen at least
_THIN = np.ones((5, 5), np.uint8)  # px, of dark lines that hide nothing
_BORDER_PX = 7  # width of the border beside what hides the spot
_BESIDE = 0.2
"""Width of that border out of the spot, over its radius. What hides the spot goes on there, and
differs less from the wall."""


def hidden_pixels(
    channels: Float[np.ndarray, "h w 3"], spot: Outline
) -> Bool[np.ndarray, "h w"] | None:
    """Pixels within a spot that do not show its light, with the border beside them.

    Args:
        channels: light of the frame's channels.
        spot: its outline, with a sharp edge.

    Returns:
        The pixels, or None if the spot is seen as a whole.
    """
    reach = math.ceil(spot.semi_major_px)
    left, top = max(round(spot.x_px) - reach, 0), max(round(spot.y_px) - reach, 0)
    part = channels[top : round(spot.y_px) + reach + 1, left : round(spot.x_px) + reach + 1]
    if not part.size:
        return None
    light = part.mean(axis=-1)
    inside = np.zeros(light.shape, np.uint8)
    inner = 2.0 * max(spot.semi_minor_px - spot.edge_width_px, 0.0)
    outer = inner * spot.semi_major_px / spot.semi_minor_px
    middle = spot.x_px - left, spot.y_px - top
    cv2.ellipse(inside, (middle, (outer, inner), math.degrees(spot.angle_rad)), 1, cv2.FILLED)
    if not inside.any():
        return None
    dark = inside & (light < _DARK * np.quantile(light[inside > 0], _BRIGHT))
    dark = cv2.morphologyEx(dark.astype(np.uint8), cv2.MORPH_OPEN, _THIN)
    if not dark.any():
        return None
    hidden = np.zeros(channels.shape[:2], np.uint8)
    hidden[top : top + len(light), left : left + light.shape[1]] = dark
    beside = cv2.dilate(hidden, _square(_BESIDE * spot.semi_minor_px))
    beside[top : top + len(light), left : left + light.shape[1]][inside > 0] = 0
    return np.logical_or(cv2.dilate(hidden, _square(_BORDER_PX)), beside)


def _square(width_px: float) -> np.ndarray:
    return np.ones((round(width_px), round(width_px)), np.uint8)
