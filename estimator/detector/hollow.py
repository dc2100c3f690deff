"""Dark places inside an ellipse that nothing which reaches in from outside can explain.

A shaft or a shadow in front of a spot begins outside the spot: from every point of it, a straight
way through the dark leads out. A letter or a ring is dark behind a bright stroke.
"""

from __future__ import annotations

import math

import cv2
import numpy as np

from estimator.detector.ellipse import Ellipse
from estimator.detector.tuning import RAYS, Hollow, Sharp
from estimator.detector.unwrap import Patch

_AT = np.linspace(-1, 1, Hollow.SIDE, dtype=np.float32)
_X, _Y = np.meshgrid(_AT, _AT)
_RADIUS = np.hypot(_X, _Y)
_RAY = np.rint(np.arctan2(_Y, _X) * (RAYS / (2 * math.pi))).astype(int) % RAYS
_THICK = np.ones((3, 3), np.uint8)  # along a thinner line, a way strays into the bright
_MIDDLE = (Hollow.SIDE - 1) / 2
_TURNS = [
    cv2.getRotationMatrix2D((_MIDDLE, _MIDDLE), degrees, 1)
    for degrees in np.arange(0, 180, 180 / Hollow.DIRECTIONS).tolist()
]


def hollow_share(
    patch: Patch, ellipse: Ellipse, seen: np.ndarray, half: float, width: float
) -> float:
    """Area of dark places behind a visible edge, over the area inside the edge.

    Args:
        patch: signal round the ellipse.
        ellipse: px.
        seen: (RAYS,) rays on which its edge is visible.
        half: the signal below which a place is dark.
        width: of the edge, radii.
    """
    inside = _RADIUS < 1 - Sharp.PLATEAU * width
    light = _on_grid(patch, ellipse)
    dark = inside & (light < half)
    area = np.count_nonzero(inside)
    if np.count_nonzero(dark) <= Hollow.SHARE * area:
        return 0.0
    thick = cv2.morphologyEx(dark.view(np.uint8), cv2.MORPH_OPEN, _THICK).view(bool)
    passable = np.where(inside, dark | np.isnan(light), ~seen[_RAY])
    return np.count_nonzero(thick & ~_reached_from_outside(passable)) / area


def _on_grid(patch: Patch, ellipse: Ellipse) -> np.ndarray:
    """The signal on a grid on which the ellipse is the unit circle; NaN outside the patch."""
    x0, y0 = ((ellipse.centre - (patch.x0, patch.y0)) / patch.stride).tolist()
    (a, b), (c, d) = (ellipse.shape / patch.stride).astype(np.float32)
    x, y = np.float32(x0) + a * _X + b * _Y, np.float32(y0) + c * _X + d * _Y
    return cv2.remap(
        patch.signal, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=math.nan
    )


def _reached_from_outside(passable: np.ndarray) -> np.ndarray:
    """Pixels from which some straight way through passable pixels leads to the image's border."""
    reached = np.zeros_like(passable)
    for turn in _TURNS:
        turned = cv2.warpAffine(
            passable.view(np.uint8), turn, passable.shape, flags=cv2.INTER_NEAREST, borderValue=1
        )
        ways = np.minimum.accumulate(turned, axis=1)
        ways |= np.minimum.accumulate(turned[:, ::-1], axis=1)[:, ::-1]
        flags = cv2.INTER_NEAREST | cv2.WARP_INVERSE_MAP
        reached |= cv2.warpAffine(ways, turn, passable.shape, flags=flags).view(bool)
    return reached
