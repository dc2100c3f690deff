"""Sensor model (EMVA 1288, release 4.0, linear): noise-free light in, digital numbers out.

The linear model of the standard counts electrons n_e. Their number is Poisson distributed; its mean
is the light collected plus the dark signal. The read noise is normal. The overall system gain K
converts electrons to digital numbers (DN):

    dn = round(black level + K (n_e + offset + read noise)),
    K = (full scale - black level) / full well.

Light is given as a fraction of the full well, so one factor, `exposure`, stands for quantum
efficiency, pixel area and exposure time. With a Bayer filter each pixel measures one colour; the
other two are interpolated from its neighbours. A response curve, if the camera has one, acts last,
on dn / full scale.
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from optics import InputError
from scenes.camera.output import demosaiced, mosaic
from scenes.camera.response import CONVERTER_MAX, response_table
from scenes.description import CameraSettings

# A normal number with the mean and variance of a Poisson number lacks its skewness. This error is
# accepted from 50 electrons, where the skewness is 1/sqrt(50) = 0.14.
_NORMAL_FROM_E = 50.0

# Samples per pass: few enough that the arrays of a pass stay in the processor's cache.
_BLOCK = 1 << 16


class FixedPatterns(NamedTuple):
    """Differences between the pixels of one sensor, the same in all frames.

    Attributes:
        gain: 1 + PRNU, sensitivity of a pixel relative to the mean.
        offset_e: DSNU, dark value of a pixel minus the mean dark value, electrons.
    """

    gain: NDArray[np.float32]
    offset_e: NDArray[np.float32]


def fixed_patterns(
    *, settings: CameraSettings, shape: tuple[int, ...], seed: int | np.random.SeedSequence
) -> FixedPatterns:
    """Photo-response and dark-signal non-uniformity (PRNU, DSNU of EMVA 1288) of one sensor.

    Both are white and normal; row patterns, column patterns and defect pixels are not modelled.

    Args:
        settings: the camera, whose `prnu` and `dsnu_e` are the standard deviations.
        shape: shape of the images that the sensor takes.
        seed: random seed; it identifies the sensor.

    Returns:
        Two maps of that shape.
    """
    rng = np.random.default_rng(seed)
    gain = rng.standard_normal(shape, dtype=np.float32)
    gain *= np.float32(settings.prnu)
    gain += np.float32(1.0)
    # With a PRNU of tens of percent some gains would be negative; such a pixel is dead.
    np.maximum(gain, 0.0, out=gain)
    offset_e = rng.standard_normal(shape, dtype=np.float32)
    offset_e *= np.float32(settings.dsnu_e)
    return FixedPatterns(gain=gain, offset_e=offset_e)


def expose(
    linear: NDArray[np.floating],
    *,
    exposure: float,
    settings: CameraSettings,
    rng: np.random.Generator,
    patterns: FixedPatterns | None = None,
) -> NDArray[np.uint8] | NDArray[np.uint16]:
    """Take one photograph of a noise-free linear image.

    Args:
        linear: light in any linear unit, not negative; any shape, or H x W x 3 for a camera with
            a Bayer filter.
        exposure: full wells per unit of `linear`; the well is full where exposure * linear = 1.
        settings: the camera.
        rng: random numbers of the temporal noise.
        patterns: fixed patterns of the sensor, of the raw frame's shape
            (`CameraSettings.sensor_shape`); needed if `settings` has PRNU or DSNU.

    Returns:
        Digital numbers of the image's shape: uint8 at 8 bits, uint16 above.

    Raises:
        InputError: image or exposure are negative or not finite; patterns are missing or have
            another shape.
    """
    light = np.array(linear, dtype=np.float32, order="C")
    _check_light(light, exposure, settings)
    if settings.bayer != "none":
        light = mosaic(light, bayer=settings.bayer)
    _check_patterns(light.shape, settings, patterns)

    curve = response_table(settings)
    full_scale = settings.full_scale_dn if curve is None else CONVERTER_MAX
    light *= np.float32(exposure * settings.full_well_e)
    raw = _raw(light, full_scale, settings, rng, patterns)
    if settings.bayer != "none":
        raw = demosaiced(raw, bayer=settings.bayer)
    return raw if curve is None else curve[raw]


def _raw(
    light_e: NDArray[np.float32],
    full_scale: int,
    settings: CameraSettings,
    rng: np.random.Generator,
    patterns: FixedPatterns | None,
) -> NDArray[np.uint8] | NDArray[np.uint16]:
    """Output of the converter for a mean number of electrons per pixel.

    `full_scale` is the largest output.
    """
    raw = np.empty(light_e.shape, np.uint8 if full_scale < 256 else np.uint16)
    per_dn = full_scale / settings.full_scale_dn
    gain = np.float32(settings.system_gain * per_dn)
    # Adding half a step turns the truncation at the end into rounding.
    black = np.float32(settings.black_level_dn * per_dn + 0.5)
    dark_e = np.float32(settings.dark_signal_e)
    read_variance = np.float32(settings.read_noise_e**2)
    few_e = _counted_below_e(settings)

    flat, flat_raw = light_e.reshape(-1), raw.reshape(-1)
    noise = np.empty(_BLOCK, np.float32)
    for start in range(0, flat.size, _BLOCK):
        part = slice(start, start + _BLOCK)
        mean = flat[part]
        if patterns is not None:
            mean *= patterns.gain.reshape(-1)[part]
        mean += dark_e
        # One normal number gives the sum of shot and read noise. Where electrons are counted, it
        # gives the read noise only.
        variance = mean + read_variance
        for few in _few_electrons(mean, few_e):
            mean[few] = _poisson(mean[few], rng)
            variance[few] = read_variance
        electrons = noise[: mean.size]
        rng.standard_normal(out=electrons, dtype=np.float32)
        electrons *= np.sqrt(variance, out=variance)
        electrons += mean
        if patterns is not None:
            electrons += patterns.offset_e.reshape(-1)[part]
        electrons *= gain
        electrons += black
        np.clip(electrons, 0, full_scale, out=electrons)
        flat_raw[part] = electrons
    return raw


def _counted_below_e(settings: CameraSettings) -> float:
    """Mean number of electrons below which Poisson numbers are drawn instead of normal ones.

    The sum of m electrons and of read noise with variance s has the skewness m/(m + s)^(3/2). So
    normal read noise reduces the skewness; from 2.7 electrons no Poisson numbers are needed.
    """
    s = settings.read_noise_e**2
    # The skewness equals that of 50 electrons without read noise if 50 m^2 = (m + s)^3.
    roots = np.roots([1.0, 3 * s - _NORMAL_FROM_E, 3 * s**2, s**3])
    return max(0.0, *roots[np.isreal(roots)].real)


def _few_electrons(mean: NDArray[np.float32], few_e: float) -> list[NDArray[np.intp]]:
    """Indices of the pixels that need Poisson numbers, grouped by their mean."""
    if mean.min() >= few_e:
        return []
    edges = (-math.inf, min(6.0, few_e), few_e)
    return [np.flatnonzero((mean >= low) & (mean < high)) for low, high in pairwise(edges)]


def _poisson(mean: NDArray[np.float32], rng: np.random.Generator) -> NDArray[np.uint8]:
    """Poisson numbers with a small mean, by inversion with sequential search (Devroye 1986, X.3.3).

    All pixels search at the same time. For the few electrons of an unlit wall this is several times
    faster than `rng.poisson`.
    """
    count = np.zeros(mean.shape, np.uint8)
    # In single precision the probabilities sum to 1 within 5e-7; without this margin the search
    # might not end.
    rest = rng.random(mean.shape, dtype=np.float32) - np.float32(1e-6)
    chance = np.exp(-mean)
    n = 0
    while True:
        rest -= chance
        more = rest > 0
        if not more.any():
            return count
        count += more
        n += 1
        chance *= mean
        chance *= np.float32(1 / n)


def _check_light(light: NDArray[np.float32], exposure: float, settings: CameraSettings) -> None:
    if not 0 <= exposure < math.inf:
        raise InputError(f"expose(exposure=...) must be finite and not negative; got {exposure:g}.")
    if light.size == 0:
        raise InputError(f"expose(linear=...) must contain pixels; got shape {light.shape}.")
    low, high = float(light.min()), float(light.max())
    # Electrons are summed in single precision; 1e30 is far below its largest number.
    if not (low >= 0 and high * exposure * settings.full_well_e < 1e30):
        raise InputError(
            f"expose(linear=...) must be finite and not negative; got values from "
            f"{low:g} to {high:g} at exposure={exposure:g}. Clip negative values, or lower the "
            f"exposure."
        )


def _check_patterns(
    shape: tuple[int, ...], settings: CameraSettings, patterns: FixedPatterns | None
) -> None:
    if patterns is None:
        if settings.prnu > 0 or settings.dsnu_e > 0:
            raise InputError(
                f"expose(patterns=...) is needed for a camera with prnu={settings.prnu:g} and "
                f"dsnu_e={settings.dsnu_e:g}. Call fixed_patterns once for the whole stack."
            )
    elif patterns.gain.shape != shape or patterns.offset_e.shape != shape:
        raise InputError(
            f"expose(patterns=...) must have the image's shape {shape}; got "
            f"{patterns.gain.shape} and {patterns.offset_e.shape}. Make them with that shape."
        )
