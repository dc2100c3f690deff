"""Is a spot clipped, and at which value?"""

import math

import numpy as np

from eyespot.estimator.detector.tuning import Clipping


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
    if seen.size < Clipping.FEWEST:
        return math.inf
    level = seen[-1 - int(Clipping.ODD * seen.size)]
    first, end = np.searchsorted(seen, level), np.searchsorted(seen, level, side="right")
    if end - first < Clipping.FEWEST:
        return math.inf
    height = float(level) - float(seen[0])
    if not height > 0:  # nothing shows how the light rises to the level
        return math.inf
    band = max(Clipping.BAND * height, 1.0 if seen.dtype.kind == "u" else 0.0)
    upper, lower = np.searchsorted(seen, float(level) - band * np.array([1, 2]))
    _, beside = np.unique(seen[upper:first], return_counts=True)
    usual = int(beside[-Clipping.BELOW :].max(initial=0))
    if end - first < 1.5 * usual + Clipping.SURE * math.sqrt(usual + 1):
        return math.inf
    near, next_ = int(first - upper), int(upper - lower)
    start, stop = np.searchsorted(seen, float(seen[0]) + height * np.array([0.1, 0.6]))
    flank = (stop - start) * band / (0.5 * height)
    fine = np.searchsorted(seen, float(level) - band * np.array([0.25, 0.5]))
    nearest, beyond = int(first - fine[0]), int(fine[0] - fine[1])
    flat = _exceeds(near, Clipping.FLAT, next_) and near > Clipping.FLANK * flank
    flat &= _exceeds(nearest, Clipping.RISES, beyond)
    dark = float(values.min())
    shares = (values[(values > dark) & (values < level)] - dark) / (float(level) - dark)
    foot, middle, shoulder = np.histogram(shares, [Clipping.FOOT, 0.3, 0.7, 1 - Clipping.FOOT])[0]
    sharp = foot + middle + shoulder < Clipping.SHARP_PX * 2 * math.sqrt(math.pi * seen.size)
    sharp &= not _exceeds(int(foot), Clipping.UNEVEN, int(shoulder))
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
    rounded = Clipping.ROUNDED if values.dtype.kind == "u" else 0
    turns = (bend[:, :-1] * bend[:, 1:])[around] < -rounded
    if np.count_nonzero(turns) > Clipping.TURNS * around.sum() > 0:
        return True
    flat = values >= level
    darker = values[:, 1:-1][bright[:, 1:-1] & ~flat[:, 1:-1] & flat[:, :-2] & flat[:, 2:]]
    deep = np.count_nonzero(darker < darker.max(initial=0))
    return darker.size >= Clipping.FEWEST and bool(deep > Clipping.DEEP * darker.size)
