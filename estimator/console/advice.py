"""What the operator can do about the exposure."""

from __future__ import annotations

import numpy as np

from estimator.image import NoSpot, Response, Spot

_SATURATED = 0.01  # of the spot; below it are single hot pixels and reflections
_DARK, _GOOD = 0.25, 0.8  # of full scale; at a quarter, noise of the edge has four times its least


def exposure_advice(result: Spot | NoSpot, frame: np.ndarray, response: Response) -> str:
    """One sentence about the exposure; empty if it is right.

    Args:
        result: what was measured in the frame.
        frame: the frame.
        response: of the camera.
    """
    if isinstance(result, NoSpot):
        return ""
    if result.saturated > _SATURATED:
        # How far the light exceeds full scale is not in the image, so: halve it, and look again.
        return f"{result.saturated:.0%} of the spot is saturated: halve the exposure."
    inside = _inside(result, frame)
    if not inside.size or (frame.dtype != np.uint8 and response.full_scale is None):
        return ""  # of 16 bits, a camera may use 10
    peak = float(np.percentile(inside, 99)) / response.full_scale_of(frame)
    if peak < _DARK:
        return (
            f"The spot reaches {peak:.0%} of full scale: make the exposure"
            f" {_GOOD / max(peak, 0.01):.0f} times as long."
        )
    return ""


def _inside(spot: Spot, frame: np.ndarray) -> np.ndarray:
    """The brightest channel of the square in the spot's ellipse."""
    half = spot.semi_minor_px / np.sqrt(2)
    x0, x1 = (max(round(spot.x_px + side * half), 0) for side in (-1, 1))
    y0, y1 = (max(round(spot.y_px + side * half), 0) for side in (-1, 1))
    patch = frame[y0 : y1 + 1, x0 : x1 + 1]
    return patch.max(axis=2) if patch.ndim == 3 else patch
