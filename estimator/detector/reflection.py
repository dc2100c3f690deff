"""Distinguishes a broad spot from a specular reflection of a wet wall with the spot on it.

A wet or varnished wall reflects the microscope's light as a wide bell, which may be brighter than
the spot. A spot with a broad edge is smooth throughout; a reflection shows the sharp rim of the
spot.
"""

from __future__ import annotations

import cv2
import numpy as np

from estimator.detector.coarse import Coarse, TooSmall, bright_regions
from estimator.detector.edges import EdgeFit, fit_edge
from estimator.detector.tuning import Reflection
from estimator.detector.unwrap import Patch


def spot_on(patch: Patch, bell: EdgeFit, smallest_px: float) -> EdgeFit | None:
    """The ellipse with a sharp rim that a bell shows; None if it shows none.

    Args:
        patch: signal round the bell.
        bell: its fit.
        smallest_px: least semi-minor axis of a spot; smaller sharp blobs are noise.
    """
    half_width, half_height = bell.ellipse.half_extent()
    x, y = (bell.ellipse.centre - (patch.x0, patch.y0)).tolist()
    left, top = max(int(x - half_width), 0), max(int(y - half_height), 0)
    light = patch.signal[top : int(y + half_height) + 1, left : int(x + half_width) + 1]
    stride = max(light.shape) // Reflection.SIDE + 1
    height, width = (length // stride for length in light.shape)
    if min(height, width) < 2 * Reflection.POWERS:
        return None
    light = light[: height * stride, : width * stride]
    small = cv2.resize(light, (width, height), interpolation=cv2.INTER_AREA)
    down, across = _polynomials(height), _polynomials(width)
    surface = down @ (down.T @ small @ across) @ across.T
    x0, y0 = int(patch.x0) + left, int(patch.y0) + top
    coarse = Coarse.of_signal(small - surface, stride=stride, x0=x0, y0=y0)
    above = light - cv2.resize(surface, light.shape[::-1], interpolation=cv2.INTER_LINEAR)
    standing_out = Patch(above, x0, y0)
    rims: list[EdgeFit] = []
    # Without its surface, a bell leaves rings.
    for candidates in bright_regions(
        coarse, min_contrast=0, min_area=Reflection.SMALLEST * light.size, solid=False
    ):
        if isinstance(candidates, TooSmall):
            continue
        fits = (fit_edge(standing_out, coarse, candidate) for candidate in candidates)
        rims += [fit for fit in fits if isinstance(fit, EdgeFit) and _is_rim(fit, smallest_px)]
    return max(rims, key=lambda rim: float(rim.inliers.mean()), default=None)


def _is_rim(fit: EdgeFit, smallest_px: float) -> bool:
    sharp = fit.levels.width < Reflection.SHARPEST and fit.scatter < Reflection.SMOOTHEST
    return (
        sharp and bool(fit.inliers.mean() > Reflection.SEEN) and fit.ellipse.axes()[1] > smallest_px
    )


def _polynomials(number: int) -> np.ndarray:
    """Orthonormal polynomials on as many points, in columns."""
    return np.linalg.qr(np.vander(np.linspace(-1, 1, number), Reflection.POWERS))[0].astype(
        np.float32
    )
