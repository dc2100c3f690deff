"""A camera's noise from pairs of frames of an even wall: photon transfer (EMVA 1288).

The difference of two frames of one scene contains no scene, only noise. Its variance grows with the
mean by the system's gain K, in DN per electron: sigma² = sigma_dark² + K (mu - mu_dark).
"""

from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Float

from eyespot.formats.camera_sheet import CameraSheet
from eyespot.formats.inputs import InputError

_MIDDLE_SHARE = 0.5  # share of the frame's width and height: the middle is the most even part
_LIT_SHARE = 0.1  # share of full scale; a pair with the light off lies below
_UNCLIPPED_SHARE = 0.9  # share of full scale; above, noise is clipped
_MIN_LEVELS = 3.0  # least ratio of the brightest and the darkest pair with light
_MAX_CURVATURE = 0.05
"""Largest deviation of a pair's variance from the line, relative, without scatter."""
_ROUNDING = 1.0 / 12.0  # DN², variance of rounding to whole numbers
_SMOOTH_PX = 7  # side of the box that takes the wall's shading out of the fixed pattern


class PhotonTransfer(NamedTuple):
    """A camera's data sheet, measured.

    Attributes:
        gain_dn_e: K, DN per electron.
        gain_sigma_dn_e: its standard error.
        worst: largest deviation of a variance from the line, relative.
    """

    sheet: CameraSheet
    gain_dn_e: float
    gain_sigma_dn_e: float
    worst: float


def measured_noise(
    pairs: list[tuple[np.ndarray, np.ndarray]], *, bit_depth: int, bayer: bool = False
) -> PhotonTransfer:
    """Measure a camera with a linear response.

    Args:
        pairs: two frames each of one scene and exposure, H x W x 3; one pair or more in the dark,
            and at least three at different brightness.
        bit_depth: that the camera uses per channel.
        bayer: whether colours are interpolated behind a Bayer filter.

    Raises:
        InputError: no dark pair, too few bright ones, or a variance that does not grow in
            proportion to the light: another response, an automatic gain, or a scene that moved.
    """
    full_scale = (1 << bit_depth) - 1
    most = max(int(frame.max()) for pair in pairs for frame in pair)
    if most > full_scale:
        raise InputError(
            f"the images have values up to {most}, above the full scale {full_scale} of the bit "
            "depth. Give another --bit-depth; values that were shifted to the upper bits must be "
            "shifted back."
        )
    usable = [
        pair
        for pair in pairs
        if np.mean(pair) < _LIT_SHARE * full_scale or not any(map(_is_clipped, pair))
    ]
    if not usable:
        raise InputError(
            f"in all {len(pairs)} pairs the light reaches full scale, {full_scale} DN, where noise "
            "ends. Lower the exposure or the light, and add a pair with the light off."
        )
    # Sorted by the mean.
    mean, noise, pattern, pixels = np.array(sorted(_pair(*pair) for pair in usable)).T
    dark, lit = mean < _LIT_SHARE * full_scale, mean < _UNCLIPPED_SHARE * full_scale
    lit &= ~dark
    if not dark.any():
        raise InputError(
            f"the darkest pair has a mean of {mean[0]:.1f} DN of {full_scale}; a pair with "
            f"the light off must lie below {_LIT_SHARE * full_scale:.0f} DN. Add one."
        )
    if lit.sum() < 3 or mean[lit][-1] < _MIN_LEVELS * mean[lit][0]:
        raise InputError(
            f"{lit.sum()} pairs lie between {_LIT_SHARE * full_scale:.0f} and "
            f"{_UNCLIPPED_SHARE * full_scale:.0f} DN; at least three are needed, the brightest "
            f"{_MIN_LEVELS:g} times as bright as the darkest. Change the exposure or the light."
        )
    black = float(mean[dark].mean())
    light, variance = mean[lit] - black, noise[lit]
    # A variance from n pixels scatters by sqrt(2/n) of itself.
    scatter = variance * np.sqrt(2.0 / pixels[lit])
    # A straight line. The dark pair gives the black level only: noise below a step of the file is
    # rounded away.
    (gain, floor), covariance = np.polyfit(light, variance, 1, w=1 / scatter, cov="unscaled")
    off = np.abs(variance - floor - gain * light)
    # A curve looks straight from a third of its length on, but then misses the dark pair.
    bent = floor - noise[0] - _ROUNDING > _MAX_CURVATURE * variance.max()
    worst = float(np.max(off / variance))
    if not gain > 0 or bent or np.any(off > _MAX_CURVATURE * variance + 4.0 * scatter):
        raise InputError(
            f"the noise's variance is off a straight line in the light by {100 * worst:.0f} %. "
            "Switch automatic exposure, gain and gamma off, let nothing move within a pair, and "
            "record raw frames."
        )
    unevenness = (pattern[lit] - pattern[0]) / light**2
    sheet = CameraSheet(
        full_well_e=(full_scale - black) / gain,
        read_noise_e=float(np.sqrt(max(floor - _ROUNDING, 0.0))) / gain,
        black_level_dn=black,
        bit_depth=bit_depth,
        prnu=float(np.sqrt(max(float(np.median(unevenness)), 0.0))),
        dsnu_e=float(np.sqrt(max(pattern[0], 0.0))) / gain,
        bayer=bayer,
    )
    return PhotonTransfer(sheet, float(gain), float(np.sqrt(covariance[0, 0])), worst)


def _is_clipped(frame: np.ndarray) -> bool:
    """Whether more pixels have the largest value of a channel than the next one: noise ends."""
    for plane in np.moveaxis(np.atleast_3d(_middle(frame)), 2, 0):
        _, counts = np.unique(plane, return_counts=True)
        if counts[-1] > max(2 * counts[-2:-1].sum(), 0.01 * plane.size):
            return True
    return False


def _pair(first: np.ndarray, second: np.ndarray) -> tuple[float, float, float, float]:
    """Mean, temporal variance, variance of the fixed pattern, and number of pixels."""
    if first.shape != second.shape:
        raise InputError(
            f"the frames of a pair must have one size; got {first.shape} and {second.shape}."
        )
    one, other = (_middle(frame).astype(float) for frame in (first, second))
    difference = one - other
    variance = float(np.mean(np.var(difference, axis=(0, 1)))) / 2.0
    mean = 0.5 * (one + other)
    rough = mean - cv2.blur(mean, (_SMOOTH_PX, _SMOOTH_PX)).reshape(mean.shape)
    # The box takes its own share of each pixel out, and the mean of two frames has half the noise.
    kept = 1.0 - 1.0 / _SMOOTH_PX**2
    pattern = float(np.mean(np.var(rough, axis=(0, 1)))) / kept - variance / 2.0
    return float(np.mean(one + other)) / 2.0, variance, pattern, difference.size


def _middle(frame: Float[np.ndarray, "h w 3"]) -> Float[np.ndarray, "rows columns 3"]:
    height, width = frame.shape[:2]
    rows, columns = (
        round(0.5 * (1 - _MIDDLE_SHARE) * height),
        round(0.5 * (1 - _MIDDLE_SHARE) * width),
    )
    return frame[rows : height - rows, columns : width - columns]
