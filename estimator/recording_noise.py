"""A camera's noise, measured in a recording itself.

Two neighbouring frames show the same wall in light that has changed smoothly. The logarithm of
their ratio has no texture, and its difference of second order in both directions has no smooth
change of the light: what is left is noise. It is measured in means over cells, as the fits use
them, and so contains what Bayer filters, JPEG, sharpening or denoising do to the noise of
neighbouring pixels: the variance of a mean is then not that of a pixel over their number.
"""

import itertools
import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import maximum_filter
from scipy.optimize import nnls

from eyespot.estimator.camera_noise import CameraNoise
from eyespot.estimator.detector.clipping import clip_level
from eyespot.formats.camera_sheet import VIDEO_BLACK, VIDEO_WHITE, CameraSheet, Response
from eyespot.formats.inputs import InputError

_CELL_PX = 6
"""Side of the cells, the middle of the 4 to 8 px of the fits' cells."""
_STRIDE_PX = 12
"""Distance of the cells. Between them are 6 px, over which neither a Bayer filter nor the blocks of
JPEG, 8 px, make much noise common to two cells; 3 px made it up to 8 % too small. Nine cells then
span 30 px, over which the light must change smoothly."""
_KNOT = 0.01
"""Light, full wells, below which cells are compared by their difference instead of their ratio."""
_SECOND, _SLOPE, _SUM = (np.array(k, float) for k in ([1, -2, 1], [-1, 0, 1], [1, 1, 1]))
_NOISE = np.outer(_SECOND, _SECOND)
_CURVED = np.stack([np.outer(_SUM, _SECOND), np.outer(_SECOND, _SUM)])
_STEEP = np.stack([np.outer(_SUM, _SLOPE), np.outer(_SLOPE, _SUM)])
"""Weights of 3 x 3 cells: zero for light that changes with the square of the place; and those that
show how it changes, whose noise is independent of the former's."""
_MOST_CURVED, _MOST_STEEP = 2.0, 10.0
"""Standard deviations of noise: what changes more may be an edge of the spot or of a tool. With 3
and no limit, the noise in a growing spot with a sharp edge was up to 15 % too large."""
_BESIDE = 2.0
"""How much more may change beside a cell: the foot of an edge changes less than its middle."""
_UNUSED = 0.1
"""A channel is not in use if so much fewer of its pixels are above black than of another one."""
_CLIP = 4.0
"""Standard deviations beyond which a difference is no noise but something that moved."""
_CLIPPED_VARIANCE = 0.9989
"""Variance of a normal distribution that is cut at `_CLIP`."""
_MEDIAN = 0.4549
"""Median of the square of a normal number, over its variance."""
_QUARTER = 0.3186
"""Standard deviations below which a quarter of normal numbers are."""
_LEVELS = 12
"""Groups of equal size into which cells are put by their light."""
_FEWEST = 100
"""Least number of cells in a group; its variance is then known to 14 %."""
_MODEL_ERROR = 0.03
"""Relative error of a group's variance beyond its scatter: JPEG is no straight line, either."""
_CURVATURE_CHI2 = 9.0
"""Improvement of chi squared, three standard errors, from which the square of the light counts."""
_ROUNDS = 6
"""Repetitions: which cells are good, and their weights, follow from the noise that is measured."""
_MOST_PIXELS = 10_000_000
"""Pixels of all pairs, evenly drawn: 32 pairs of 640 x 480 px, in 60,000 places and 2 s."""
_EXACT_E = 1e15


class _NoiseCells(NamedTuple):
    """Differences between two frames in 3 x 3 cells, and their variances by cause, n each.

    Attributes:
        noise: without texture and light.
        change: how the light changes beyond a ratio, in units of the most that noise may change.
        level: mean light, full wells.
        terms: 3 x n: the variance if that of a pixel's channel were 1, the light, or its square.
        rounded: the variance by rounding to whole values.
    """

    noise: Float[np.ndarray, "n"]
    change: Float[np.ndarray, "n"]
    level: Float[np.ndarray, "n"]
    terms: Float[np.ndarray, "3 n"]
    rounded: Float[np.ndarray, "n"]


def noise_of_frames(
    frames: Sequence[np.ndarray], *, response: Response, bit_depth: int, black_level_dn: float
) -> CameraNoise:
    """Measure a camera's noise in frames of a wall at rest whose light changes smoothly.

    The variance is a + b L in the light L, and rounding; if this does not describe it, c L² is
    added, such as by a shake of the image.

    Args:
        frames: H x W or H x W x 3, uint8 or uint16, in their order.
        response: of the camera.
        bit_depth: bits per channel that the camera uses.
        black_level_dn: mean value of a dark image.

    Returns:
        The noise, for which `variance(light)` over 36 is the variance of a mean over 6 x 6 pixels
        and all channels. Its full well and its noise in the dark are those of a camera without
        correlated noise whose means scatter alike; `prnu` is the square root of c.

    Raises:
        InputError: too few pixels are clear of black and white in pairs of unequal frames.
    """
    exact = CameraSheet(
        full_well_e=_EXACT_E, read_noise_e=0.0, black_level_dn=black_level_dn, bit_depth=bit_depth
    )
    camera = CameraNoise(exact, response)
    found = [_compared(*pair, camera.for_image(pair[0])) for pair in _pairs(frames)]
    variances, count = None, 0
    if found:
        cells = _NoiseCells(*(np.concatenate(part, axis=-1) for part in zip(*found, strict=True)))
        variances, count = _variances(cells), cells.level.size
    if variances is None:
        raise InputError(
            f"the camera's noise cannot be measured: {len(found)} pairs of unequal neighbouring "
            f"frames have {count} places clear of black and white; at least {_LEVELS * _FEWEST} "
            "must show a wall at rest in light that changes smoothly. State the noise in "
            "[camera.noise]: full_well_e, read_noise_e, black_level_dn and bit_depth, as "
            "`eyespot camera` measures them."
        )
    constant, shot, square = variances.tolist()
    full_well = 1.0 / max(shot, 1.0 / _EXACT_E)
    sheet = exact.model_copy(
        update={
            "full_well_e": full_well,
            "read_noise_e": math.sqrt(constant) * full_well,
            "prnu": math.sqrt(square),
        }
    )
    return CameraNoise(sheet, response).for_image(frames[0])


def _pairs(frames: Sequence[np.ndarray]) -> list[tuple[np.ndarray, np.ndarray]]:
    """Neighbouring frames, evenly drawn; capture cards repeat frames, which are none."""
    unequal = [
        (one, other)
        for one, other in itertools.pairwise(frames)
        if one.shape == other.shape
        and min(one.shape[:2]) >= 3 * _STRIDE_PX
        and not np.array_equal(one, other)
    ]
    pixels = sum(one.shape[0] * one.shape[1] for one, _ in unequal)
    return unequal[:: math.ceil(pixels / _MOST_PIXELS) or 1]


def _compared(first: np.ndarray, second: np.ndarray, camera: CameraNoise) -> _NoiseCells:
    """The cells of two frames of the same wall."""
    clear = (_is_clear(first, camera) & _is_clear(second, camera)).astype(np.float32)
    good = (_nine(_means(clear)) > 1 - 0.5 / _CELL_PX**2).all(axis=0)
    before, after = (
        _nine(_means(camera.light(frame).astype(np.float32))) for frame in (first, second)
    )
    # Codecs of video repeat parts of frames, too.
    good &= (before != after).any(axis=0)
    # What lies farther below the black level than noise is cut, and would seem to have no noise.
    good &= np.minimum(before.mean(axis=0), after.mean(axis=0)) > -0.5 * _KNOT
    gain = (after.mean(axis=0) + _KNOT) / (before.mean(axis=0) + _KNOT)
    # With the knot in proportion to the light, a factor on all of it cancels. Noise reaches below
    # the black level by less than half of the knot.
    shifted = [
        np.maximum(light + knot, 0.5 * _KNOT)
        for light, knot in ((before, _KNOT), (after, gain * _KNOT))
    ]
    ratio = np.log(shifted[1] / shifted[0])

    def differences(weights: np.ndarray) -> Float[np.ndarray, "k rows columns"]:
        return np.tensordot(weights.reshape(-1, 9), ratio, axes=1) / np.linalg.norm(weights[0])

    curved, steep = (np.abs(differences(k)).max(axis=0) for k in (_CURVED, _STEEP))
    pixels = camera.channel_count * _CELL_PX**2
    shares = np.square(_NOISE).reshape(9, 1, 1) / np.square(_NOISE).sum() / pixels

    def variance(of_pixel: Callable[[np.ndarray], np.ndarray]) -> Float[np.ndarray, "rows columns"]:
        return sum(
            (shares * of_pixel(np.maximum(light, 0.0)) / np.square(scale)).sum(axis=0)
            for light, scale in zip((before, after), shifted, strict=True)
        )

    change = np.maximum(curved / _MOST_CURVED, steep / _MOST_STEEP)
    return _NoiseCells(
        noise=differences(_NOISE[None])[0][good],
        change=np.maximum(change, maximum_filter(change, 3) / _BESIDE)[good],
        level=(before.mean(axis=0) + after.mean(axis=0))[good] / 2,
        terms=np.stack([variance(f)[good] for f in (np.ones_like, np.positive, np.square)]),
        rounded=variance(camera.channel_variance)[good],
    )


def _is_clear(frame: np.ndarray, camera: CameraNoise) -> Bool[np.ndarray, "h w"]:
    """Pixels that are neither black nor white in any channel."""
    black, white = 0.0, float(camera.full_scale)
    if camera.response.limited:
        black, white = VIDEO_BLACK * white, VIDEO_WHITE * white
    planes = np.moveaxis(np.atleast_3d(frame), 2, 0)
    clips = [min(clip_level(plane, plane > plane.max() // 2), white) for plane in planes]
    lit = np.array([plane > black for plane in planes])
    shown = lit.sum(axis=(1, 2))
    # Coloured light does not reach every channel; what is always black adds no noise to the mean.
    lit |= (shown < _UNUSED * shown.max())[:, None, None]
    return np.all(
        [on & (plane < clip) for on, plane, clip in zip(lit, planes, clips, strict=True)], axis=0
    )


def _means(plane: Float[np.ndarray, "h w"]) -> Float[np.ndarray, "rows columns"]:
    """Means over the cells."""
    half = _CELL_PX // 2
    height, width = (side - half + 1 for side in plane.shape)
    means = cv2.blur(plane, (_CELL_PX, _CELL_PX))
    return means[half:height:_STRIDE_PX, half:width:_STRIDE_PX].astype(float)


def _nine(means: Float[np.ndarray, "rows columns"]) -> Float[np.ndarray, "9 m n"]:
    """The 3 x 3 cells around each one that has them."""
    windows = np.lib.stride_tricks.sliding_window_view(means, (3, 3))
    return np.moveaxis(windows.reshape(*windows.shape[:2], 9), 2, 0)


def _variances(cells: _NoiseCells) -> Float[np.ndarray, "3"] | None:
    """The variance of a pixel's channel: constant, over the light, and over its square.

    Returns:
        None if too few cells are good, or the noise is as large as the light.
    """
    if cells.level.size < _LEVELS * _FEWEST:
        return None
    # A quarter of the differences is that small even if every second cell has an edge.
    shot = np.maximum(cells.terms[1], np.finfo(float).tiny)  # 0 where all is below the black level
    quiet = np.quantile(np.abs(cells.noise) / np.sqrt(shot), 0.25) / _QUARTER
    expected = np.maximum(quiet**2 * shot, cells.rounded)  # drawn frames may have no noise
    found = np.zeros(3)
    for _ in range(_ROUNDS):
        good = np.flatnonzero(cells.change < np.sqrt(expected))
        order = good[np.argsort(cells.level[good])]
        if len(order) < _LEVELS * _FEWEST:
            return None
        groups = np.array_split(order, _LEVELS)
        # Of differences over their expected standard deviation, so that all cells of a group count.
        seen = np.array([_clipped_variance((cells.noise**2 / expected)[g]) for g in groups])
        weights = 1.0 / np.hypot(seen * [math.sqrt(2.0 / len(g)) for g in groups], _MODEL_ERROR)
        rows = np.array([(cells.terms / expected)[:, g].mean(axis=1) for g in groups])
        wanted = seen - [(cells.rounded / expected)[g].mean() for g in groups]
        (found, misfit), (curved, less) = (_line(rows, wanted, weights, n) for n in (2, 3))
        if misfit - less > _CURVATURE_CHI2:
            found = curved
        expected = found @ cells.terms + cells.rounded
    return found if found[2] < 1 else None


def _clipped_variance(squares: Float[np.ndarray, "n"]) -> float:
    """Variance of normal numbers, among which are others, from their squares."""
    variance = float(np.median(squares)) / _MEDIAN
    for _ in range(_ROUNDS):
        variance = float(squares[squares < _CLIP**2 * variance].mean()) / _CLIPPED_VARIANCE
    return variance


def _line(
    rows: Float[np.ndarray, "k 3"],
    wanted: Float[np.ndarray, "k"],
    weights: Float[np.ndarray, "k"],
    count: int,
) -> tuple[Float[np.ndarray, "3"], float]:
    """The first terms without negative ones, and chi squared.

    What moves makes variances larger only, so those above the line count by their distance, others
    by its square (Huber).
    """
    scale = rows.mean(axis=0)
    found, trust = np.zeros(3), np.ones(len(rows))
    off = np.zeros(len(rows))
    for _ in range(_ROUNDS):
        root = weights * np.sqrt(trust)
        found[:count] = nnls((rows / scale * root[:, None])[:, :count], wanted * root)[0]
        off = (wanted - rows / scale @ found) * weights
        trust = 1.0 / np.maximum(off, 1.0)
    return found / scale, float(np.where(off > 1, 2 * off - 1, off**2).sum())
