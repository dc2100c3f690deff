"""Whether a bell is a spot, or a wet wall's reflex with the spot upon it.

A wet or varnished wall mirrors the microscope's light as a wide bell, which may outshine the spot.
A spot whose edge is broad is smooth throughout; a reflex bears the sharp rim of the spot.
"""

from __future__ import annotations

import cv2
import numpy as np

from estimator.detector.coarse import Coarse, TooSmall, bright_regions
from estimator.detector.edges import EdgeFit, fit_edge
from estimator.detector.unwrap import Patch

_SIDE = 64  # pixels along a side, at most, in which a rim is sought
_POWERS = 5  # of either coordinate in the surface that a bell is within its half level
_SMALLEST = 0.02  # area of what stands out, over the window's
_SHARPEST = 0.05  # radii that its edge takes at most ...
_SMOOTHEST = 0.008  # ... and that its contour scatters by: more is the wall's texture
_SEEN = 0.5  # of its contour


def bears_spot(patch: Patch, bell: EdgeFit, smallest_px: float) -> bool:
    """Whether an ellipse with a sharp rim stands out of a bell.

    Args:
        patch: signal round the bell.
        bell: its fit.
        smallest_px: semi-minor axis that a spot has at least: noise has sharp blobs, too.
    """
    half_width, half_height = bell.ellipse.half_extent()
    x, y = (bell.ellipse.centre - (patch.x0, patch.y0)).tolist()
    left, top = max(int(x - half_width), 0), max(int(y - half_height), 0)
    light = patch.signal[top : int(y + half_height) + 1, left : int(x + half_width) + 1]
    stride = max(light.shape) // _SIDE + 1
    height, width = (length // stride for length in light.shape)
    if min(height, width) < 2 * _POWERS:
        return False
    light = light[: height * stride, : width * stride]
    small = cv2.resize(light, (width, height), interpolation=cv2.INTER_AREA)
    down, across = _polynomials(height), _polynomials(width)
    surface = down @ (down.T @ small @ across) @ across.T
    x0, y0 = int(patch.x0) + left, int(patch.y0) + top
    coarse = Coarse.of_signal(small - surface, stride=stride, x0=x0, y0=y0)
    above = light - cv2.resize(surface, light.shape[::-1], interpolation=cv2.INTER_LINEAR)
    standing_out = Patch(above, x0, y0)
    for readings in bright_regions(coarse, min_contrast=0, min_area=_SMALLEST * light.size):
        if isinstance(readings, TooSmall):
            continue
        fits = (fit_edge(standing_out, coarse, candidate) for candidate in readings)
        if any(isinstance(fit, EdgeFit) and _is_rim(fit, smallest_px) for fit in fits):
            return True
    return False


def _is_rim(fit: EdgeFit, smallest_px: float) -> bool:
    sharp = fit.levels.width < _SHARPEST and fit.scatter < _SMOOTHEST
    return sharp and bool(fit.inliers.mean() > _SEEN) and fit.ellipse.axes()[1] > smallest_px


def _polynomials(number: int) -> np.ndarray:
    """Orthonormal polynomials on as many points, in columns."""
    return np.linalg.qr(np.vander(np.linspace(-1, 1, number), _POWERS))[0].astype(np.float32)
