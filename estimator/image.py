"""Values at the camera's limit, and images as people see them."""

import math
from collections.abc import Sequence

import cv2
import numpy as np

from eyespot.formats.camera import LensDistortion, Response

_ODD = 0.002  # share of the bright pixels that may exceed the level: hot pixels, writing over them
_FEWEST = 8  # pixels that have a value which is the level
_NEXT = 3  # next values below the level, none of which may have as many pixels
_SURE = 4.0  # standard deviations by which the level has more pixels than any of these
_BAND = 0.08  # of the spot's upper half: bands of values that are compared
_FLAT = 1.8  # ratio of the pixels in the band below a plateau to those in the next one; a blurred
# step that is clipped below 0.97 of its height has less than 1.5, a whole one over 4
_RISES = 1.4  # the same ratio at a quarter of the band: 1.0 at a dome that is clipped
_UNEVEN = 1.5  # ratio of a drawn edge's dark half to its bright one, above which it is clipped
_FLANK = 4.0  # ratio of the same pixels to those of a band of the flank: less than 3.7, and over 8
_FOOT = 0.05  # of the height: darker pixels are background
_SHARP = 1.2  # px: a narrower edge is drawn, a pixel wide; clipped or not, its place is known
_TURNS = 0.2  # share of neighbours whose second differences alternate; 0.4 with white noise
_ROUNDED = 4.0  # product of two second differences that rounding alone can have
_DEEP = 0.1  # share of the darker pixels amid the level's that rounding cannot explain


def clip_level(values: np.ndarray, bright: np.ndarray) -> float:
    """The value at which a spot's pixels are clipped; infinite if they are not.

    Many clipped pixels have exactly one value, the largest but for a few hot pixels. A plateau
    without noise has such a value, too. But light approaches a plateau slowly, so that many pixels
    are slightly darker, whereas clipping cuts through the flank of a spot, or through noise.

    Args:
        values: (h, w) one channel of a part of a frame, or every n-th pixel of it.
        bright: (h, w) pixels of the spot: those above about half of its height.
    """
    seen = np.sort(values[bright], kind="stable")
    if seen.size < _FEWEST:
        return math.inf
    level = seen[-1 - int(_ODD * seen.size)]
    first, end = np.searchsorted(seen, level), np.searchsorted(seen, level, side="right")
    if end - first < _FEWEST:
        return math.inf
    height = float(level) - float(seen[0])
    if not height > 0:  # nothing shows how the light rises to the level
        return math.inf
    band = max(_BAND * height, 1.0 if seen.dtype.kind == "u" else 0.0)
    upper, lower = np.searchsorted(seen, float(level) - band * np.array([1, 2]))
    _, beside = np.unique(seen[upper:first], return_counts=True)
    usual = int(beside[-_NEXT:].max(initial=0))
    if end - first < 1.5 * usual + _SURE * math.sqrt(usual + 1):
        return math.inf
    near, next_ = int(first - upper), int(upper - lower)
    start, stop = np.searchsorted(seen, float(seen[0]) + height * np.array([0.1, 0.6]))
    flank = (stop - start) * band / (0.5 * height)
    fine = np.searchsorted(seen, float(level) - band * np.array([0.25, 0.5]))
    nearest, beyond = int(first - fine[0]), int(fine[0] - fine[1])
    flat = _exceeds(near, _FLAT, next_) and near > _FLANK * flank
    flat &= _exceeds(nearest, _RISES, beyond)
    dark = float(values.min())
    shares = (values[(values > dark) & (values < level)] - dark) / (float(level) - dark)
    foot, middle, shoulder = np.histogram(shares, [_FOOT, 0.3, 0.7, 1 - _FOOT])[0]
    sharp = foot + middle + shoulder < _SHARP * 2 * math.sqrt(math.pi * seen.size)
    sharp &= not _exceeds(int(foot), _UNEVEN, int(shoulder))
    return math.inf if (flat or sharp) and not _is_noisy(values, bright, level) else float(level)


def _exceeds(number: int, factor: float, other: int) -> bool:
    """Whether a number of pixels is surely more than another one times a factor."""
    return number - factor * other > 2 * math.sqrt(number + factor**2 * other)


def _is_noisy(values: np.ndarray, bright: np.ndarray, level: float) -> bool:
    """Whether noise changes pixels by more than rounding does: a plateau has it, too.

    It is looked for round the spot, where a row's second differences alternate, and amid the pixels
    at the level.
    """
    bend = np.diff(values.astype(np.float32), 2)
    around = ~bright[:, 1:-2] & ~bright[:, 2:-1]
    turns = (bend[:, :-1] * bend[:, 1:])[around] < (-_ROUNDED if values.dtype.kind == "u" else 0)
    if np.count_nonzero(turns) > _TURNS * around.sum() > 0:
        return True
    flat = values >= level
    darker = values[:, 1:-1][bright[:, 1:-1] & ~flat[:, 1:-1] & flat[:, :-2] & flat[:, 2:]]
    deep = np.count_nonzero(darker < darker.max(initial=0))
    return darker.size >= _FEWEST and bool(deep > _DEEP * darker.size)


_POINTS = 180  # of an ellipse: 2 px apart at a radius of 60 px


def rgb_8bit(image: np.ndarray, response: Response) -> np.ndarray:
    """A frame as 8-bit RGB; the camera's full scale becomes 255.

    Args:
        image: (H, W) or RGB (H, W, 3), of any of the types of a frame.
    """
    if image.dtype != np.uint8 or response.full_scale is not None:
        scale = 255 / response.full_scale_of(image)
        image = np.clip(np.rint(image * scale), 0, 255).astype(np.uint8)
    return cv2.cvtColor(image, cv2.COLOR_GRAY2RGB) if image.ndim == 2 else image.copy()


def outline_px(
    ellipse: Sequence[float], camera: LensDistortion | None
) -> tuple[np.ndarray, np.ndarray]:
    """An ellipse as it appears in the frame.

    Args:
        ellipse: the parameters of a spot, in the order of `PARAMETERS`.
        camera: whose distortion was removed from the ellipse; it is applied again. None for none.

    Returns:
        Points of the closed contour, (180, 2), and the centre, (2,), px.
    """
    x, y, major, minor, angle = ellipse
    t = np.linspace(0, 2 * np.pi, _POINTS, endpoint=False)
    along, across = major * np.cos(t), minor * np.sin(t)
    c, s = np.cos(angle), np.sin(angle)
    points = np.stack([x + along * c - across * s, y + along * s + across * c], 1)
    centre = np.array([[x, y]])
    if camera is not None:
        points, centre = camera.all_distorted(points), camera.all_distorted(centre)
    return points, centre[0]
