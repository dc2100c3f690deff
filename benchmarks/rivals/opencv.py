"""OpenCV alone: blur, threshold, the largest contour, and one of its three ellipse fits."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import cv2
import numpy as np

from benchmarks.rivals.entry import NO_SPOT, Answer, Entry, plain_spot
from estimator import Frame

_FITS = {"plain": cv2.fitEllipse, "ams": cv2.fitEllipseAMS, "direct": cv2.fitEllipseDirect}
_FEWEST_POINTS = 6


class Constants(NamedTuple):
    """Free constants.

    Attributes:
        level: threshold, as a fraction of the way from the frame's median to its brightest blurred
            value.
        blur_px: standard deviation of the blur before; 0 for none.
        fit: "plain" (least squares), "ams" (Taubin 1991) or "direct" (Fitzgibbon et al. 1999).
        hull: take the contour's convex hull, which bridges what an instrument hides.
        grow_px: is added to the semi-axes. A contour runs through the centres of its outermost
            pixels, half a pixel inside of the edge.
    """

    level: float
    blur_px: float = 2.0
    fit: str = "direct"
    hull: bool = True
    grow_px: float = 0.5


class OpenCV(Entry):
    """Threshold and `fitEllipse`, frame by frame."""

    def __init__(self, constants: Mapping[str, Any]) -> None:
        self._constants = Constants(**constants)

    def read(self, frame: Frame) -> Answer:
        """The ellipse of the largest bright region."""
        level, blur_px, fit, hull, grow = self._constants
        grey = cv2.cvtColor(frame.image, cv2.COLOR_RGB2GRAY)
        if blur_px:
            grey = cv2.GaussianBlur(grey, (0, 0), blur_px)
        dark, bright = float(np.median(grey)), float(grey.max())
        above = cv2.threshold(grey, dark + level * (bright - dark), 255, cv2.THRESH_BINARY)[1]
        contours, _ = cv2.findContours(above, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
        if not contours:
            return NO_SPOT
        points = max(contours, key=cv2.contourArea)
        if hull:
            points = _dense(cv2.convexHull(points))
        if len(points) < _FEWEST_POINTS:
            return NO_SPOT
        (x, y), (width, height), degrees = _FITS[fit](points)
        if not (math.isfinite(x + y) and 0 < width < math.inf and 0 < height < math.inf):
            return NO_SPOT
        return Answer(plain_spot(x, y, width / 2 + grow, height / 2 + grow, math.radians(degrees)))


def _dense(corners: np.ndarray) -> np.ndarray:
    """Points a pixel apart along a polygon: long edges of a hull weigh as much as curved ones."""
    corners = corners[:, 0].astype(float)
    steps = np.roll(corners, -1, axis=0) - corners
    lengths = np.hypot(*steps.T)
    parts = [
        start + np.linspace(0, 1, max(round(length), 1), endpoint=False)[:, None] * step
        for start, step, length in zip(corners, steps, lengths, strict=True)
    ]
    return np.concatenate(parts).astype(np.float32)[:, None]
