"""The camera: noise-free light in, digital numbers out, after EMVA 1288 (release 4.0, linear).

The standard's linear model counts electrons: their mean is the light collected plus the dark
signal, their number is Poisson, the read noise is normal, and the overall system gain K turns
electrons into digital numbers (DN):

    dn = round(black level + K (n_e + offset + read noise)),
    K = (full scale - black level) / full well.

Light enters as a fraction of the full well, so quantum efficiency, pixel area and exposure time are
one factor, `exposure`. Behind a Bayer filter each pixel has one colour, and the other two are
interpolated from its neighbours' numbers. A response curve, where the camera has one, acts last, on
dn / full scale.
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenes.camera.output import demosaiced, mosaic
from scenes.camera.response import CONVERTER_MAX, full_wells, response_table
from scenes.description import CameraSettings

# A normal number has the mean and variance of a Poisson number and misses its skewness, which from
# 50 electrons on is 1/sqrt(50) = 0.14 or less. So much may be missed of shot and read noise.
_NORMAL_FROM_E = 50.0

# Samples per pass: the working arrays of one pass stay in the cache.
_BLOCK = 1 << 16


class FixedPatterns(NamedTuple):
    """What differs from pixel to pixel and stays the same from frame to frame.

    Attributes:
        gain: 1 + PRNU, a pixel's sensitivity over the mean sensitivity.
        offset_e: DSNU, a pixel's dark value less the mean dark value, electrons.
    """

    gain: NDArray[np.float32]
    offset_e: NDArray[np.float32]


def fixed_patterns(
    *, settings: CameraSettings, shape: tuple[int, ...], seed: int | np.random.SeedSequence
) -> FixedPatterns:
    """Photo-response and dark-signal non-uniformity (PRNU, DSNU of EMVA 1288) of one sensor.

    Both are white and normal: the sensor has no rows, columns or defect pixels.

    Args:
        settings: the camera, whose `prnu` and `dsnu_e` are the standard deviations.
        shape: shape of the images that the sensor takes.
        seed: the sensor's; the same seed is the same sensor.

    Returns:
        Maps of that shape.
    """
    rng = np.random.default_rng(seed)
    gain = rng.standard_normal(shape, dtype=np.float32)
    gain *= np.float32(settings.prnu)
    gain += np.float32(1.0)
    # With a PRNU of tens of percent the normal tail reaches below zero: such a pixel is dead.
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
        exposure: full wells per unit of `linear`: where exposure * linear is 1, the well is full.
        settings: the camera.
        rng: source of the temporal noise; the call advances it.
        patterns: the sensor's, of its raw frame's shape (`CameraSettings.sensor_shape`); needed
            where `settings` has PRNU or DSNU.

    Returns:
        Digital numbers of the image's shape: uint8 at 8 bits, uint16 above.

    Raises:
        ValueError: a negative or undefined image or exposure; patterns missing or misshapen.
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
    """Numbers of the converter behind pixels whose light makes so many electrons in the mean.

    The converter's largest number is `full_scale`.
    """
    raw = np.empty(light_e.shape, np.uint8 if full_scale < 256 else np.uint16)
    per_dn = full_scale / settings.full_scale_dn
    gain = np.float32(settings.system_gain * per_dn)
    # Half a step added here makes the truncation at the end a rounding.
    black = np.float32(settings.black_level_dn * per_dn + 0.5)
    dark_e = np.float32(settings.dark_signal_e)
    read_variance = np.float32(settings.read_noise_e**2)
    few_e = counted_below_e(settings)

    flat, flat_raw = light_e.reshape(-1), raw.reshape(-1)
    noise = np.empty(_BLOCK, np.float32)
    for start in range(0, flat.size, _BLOCK):
        part = slice(start, start + _BLOCK)
        mean = flat[part]
        if patterns is not None:
            mean *= patterns.gain.reshape(-1)[part]
        mean += dark_e
        # One normal number serves shot and read noise, whose variances add; where electrons are
        # counted it is left with the read noise.
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


def metered_exposure(
    linear: NDArray[np.floating],
    *,
    settings: CameraSettings,
    peak_fraction: float = 0.8,
    mask: NDArray[np.bool_] | None = None,
) -> float:
    """Exposure that puts the brightest channel's peak at a fraction of full scale.

    The peak is a channel's 99.9th percentile, not its maximum, so that one glint or one stray
    sample of the renderer does not darken the frame: of 640 x 480 pixels 307 lie above it.

    Args:
        linear: light, H x W or H x W x channels, as for `expose`.
        settings: the camera; black level, dark signal and response curve are allowed for.
        peak_fraction: where the peak shall lie, over the largest digital number.
        mask: H x W, the pixels to meter on; without it, all.

    Returns:
        Full wells per unit of `linear`.

    Raises:
        ValueError: nothing to meter on, or a fraction out of range.
    """
    if not 0 < peak_fraction <= 1:
        raise ValueError(
            f"metered_exposure(peak_fraction=...) must lie in (0, 1]; got {peak_fraction:g}."
        )
    level = float(full_wells(np.array(peak_fraction), settings))
    if level <= 0:
        raise ValueError(
            f"metered_exposure(peak_fraction=...) must lie above the dark image; got peak_fraction="
            f"{peak_fraction:g}, black_level_dn={settings.black_level_dn:g} DN, dark_signal_e="
            f"{settings.dark_signal_e:g}. Raise peak_fraction or lower the black level."
        )
    image = np.asarray(linear, dtype=np.float32)
    pixels = image.reshape(image.shape[0] * image.shape[1], -1)
    if mask is not None:
        if mask.shape != image.shape[:2]:
            raise ValueError(
                f"metered_exposure(mask=...) must have the image's height and width "
                f"{image.shape[:2]}; got {mask.shape}."
            )
        pixels = pixels[mask.reshape(-1)]
    if len(pixels) == 0:
        raise ValueError("metered_exposure(mask=...) must hold at least one pixel; it holds none.")
    rank = math.ceil(0.999 * len(pixels)) - 1
    peak = float(np.partition(pixels, rank, axis=0)[rank].max())
    if not 0 < peak < math.inf:
        raise ValueError(
            f"metered_exposure needs light to meter on; the 99.9th percentile of the brightest "
            f"channel is {peak:g}. Give a mask with the spot in it, or set the exposure by hand."
        )
    return level / peak


def linearise(dn: NDArray[np.integer], *, settings: CameraSettings) -> NDArray[np.float32]:
    """Undo response curve, black level and mean dark signal: the inverse of `expose` but for noise.

    Args:
        dn: digital numbers of that camera.
        settings: the camera.

    Returns:
        Light in full wells, of the same shape; negative where noise took a pixel below black.
    """
    levels = np.arange(settings.full_scale_dn + 1) / settings.full_scale_dn
    return full_wells(levels, settings).astype(np.float32)[dn]


def counted_below_e(settings: CameraSettings) -> float:
    """Mean electrons below which a camera's electrons are counted, in place of a normal number.

    Shot noise of m electrons and read noise of variance s have the skewness m/(m + s)^(3/2)
    together: normal read noise hides that of few electrons, and from 2.7 electrons of it on that
    of any number.
    """
    s = settings.read_noise_e**2
    # Where the skewness is that of 50 electrons without read noise: 50 m^2 = (m + s)^3.
    roots = np.roots([1.0, 3 * s - _NORMAL_FROM_E, 3 * s**2, s**3])
    return max(0.0, *roots[np.isreal(roots)].real)


def _few_electrons(mean: NDArray[np.float32], few_e: float) -> list[NDArray[np.intp]]:
    """Indices of the pixels whose electrons are counted, those of like mean together."""
    if mean.min() >= few_e:
        return []
    edges = (-math.inf, min(6.0, few_e), few_e)
    return [np.flatnonzero((mean >= low) & (mean < high)) for low, high in pairwise(edges)]


def _poisson(mean: NDArray[np.float32], rng: np.random.Generator) -> NDArray[np.uint8]:
    """Poisson numbers of small mean, by inversion with sequential search (Devroye 1986, X.3.3).

    All pixels search in step: for the few electrons of an unlit wall that is several times faster
    than `rng.poisson`, which takes pixels one by one.
    """
    count = np.zeros(mean.shape, np.uint8)
    # The chances below sum to 1 within 5e-7 in single precision: a search for more would not end.
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
        raise ValueError(f"expose(exposure=...) must be finite and not negative; got {exposure:g}.")
    if light.size == 0:
        raise ValueError(f"expose(linear=...) must hold pixels; got shape {light.shape}.")
    low, high = float(light.min()), float(light.max())
    # Far inside single precision, in which the electrons are summed.
    if not (low >= 0 and high * exposure * settings.full_well_e < 1e30):
        raise ValueError(
            f"expose(linear=...) must be finite and not negative; got values from "
            f"{low:g} to {high:g} at exposure={exposure:g}. Clip what a filter with negative lobes "
            f"left behind, or lower the exposure."
        )


def _check_patterns(
    shape: tuple[int, ...], settings: CameraSettings, patterns: FixedPatterns | None
) -> None:
    if patterns is None:
        if settings.prnu > 0 or settings.dsnu_e > 0:
            raise ValueError(
                f"expose(patterns=...) is needed for a camera with prnu={settings.prnu:g} and "
                f"dsnu_e={settings.dsnu_e:g}. Call fixed_patterns once for the whole stack."
            )
    elif patterns.gain.shape != shape or patterns.offset_e.shape != shape:
        raise ValueError(
            f"expose(patterns=...) must have the image's shape {shape}; got "
            f"{patterns.gain.shape} and {patterns.offset_e.shape}. Make them with that shape."
        )
