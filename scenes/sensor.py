"""Camera model: from linear frames to digital numbers.

The linear model of EMVA 1288, release 4.0, counts electrons n_e. Their number is Poisson
distributed; its mean is the light collected plus the dark signal. The read noise is normal. The
overall system gain K converts electrons to digital numbers (DN):

    dn = round(black level + K (n_e + offset + read noise)),
    K = (full scale - black level) / full well.

Light is given as a fraction of the full well, so one factor, `exposure`, stands for quantum
efficiency, pixel area and exposure time. With a Bayer filter each pixel measures one colour; the
other two are interpolated from its neighbours. A response curve, if the camera has one, acts last,
on dn / full scale.
"""

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.special import log_ndtr

from eyespot.formats.camera_sheet import light_of_srgb, srgb_of_light
from eyespot.formats.inputs import InputError
from eyespot.scenes.description.scene import Scene
from eyespot.scenes.description.scene_keys import CameraSettings


def light_information(
    light: NDArray[np.floating], *, exposure: float, settings: CameraSettings
) -> NDArray[np.float64]:
    r"""Fisher information of each digital number about the light of its pixel.

    With $\mu$ electrons the number is normal with the variance $\mu$ plus dark signal, read noise
    and rounding, and clipped at full scale. Of a normal number that is clipped at $z$ standard
    deviations above its mean, the part

    $$\Phi(z) - z\varphi(z) + \varphi(z)^2/(1 - \Phi(z))$$

    of the information $1/\sigma^2$ remains (Tobin 1958; the first two derivatives of the clipped
    likelihood). The variance's own dependence on the light, which adds 1/(2 μ) of it, the fixed
    patterns, JPEG, and the rounding of a response curve are ignored.

    Args:
        light: noise-free light, H x W x 3, as for `expose`.
        exposure: full wells per unit of `light`.

    Returns:
        Per squared unit of `light`, H x W x 3; 0 for colours that a pixel does not measure.
    """
    per_light = exposure * settings.full_well_e
    electrons = np.asarray(light, dtype=float) * per_light + settings.dark_signal_e
    variance = np.maximum(electrons, 0.0) + settings.dark_variance_e2
    z = (settings.full_well_e - electrons) / np.sqrt(variance)
    density = np.exp(-0.5 * z**2) / np.sqrt(2 * np.pi)
    below = np.exp(log_ndtr(z))
    # phi/(1 - Phi) is close to z far above the mean, where both vanish.
    above = np.exp(-0.5 * z**2 - log_ndtr(-z)) / np.sqrt(2 * np.pi)
    kept = np.clip(below - z * density + density * above, 0.0, 1.0)
    information = per_light**2 * kept / variance
    if settings.bayer != "none":
        information = information * _measured(information.shape[:2], settings.bayer)
    return np.asarray(information)


def _measured(shape: tuple[int, int], bayer: str) -> NDArray[np.bool_]:
    """Whether a pixel measures a colour, H x W x 3."""
    measured = np.zeros((*shape, 3), bool)
    for position, colour in enumerate(bayer):
        row, column = divmod(position, 2)
        measured[row::2, column::2, "RGB".index(colour)] = True
    return measured


# A step of 16 bits is at most a twentieth of a step of the 8-bit output, even where sRGB is
# steepest (slope 12.92).
CONVERTER_MAX = (1 << 16) - 1
"""Full scale of the converter before a response curve."""


def full_wells(fraction: NDArray[np.float64], settings: CameraSettings) -> NDArray[np.float64]:
    """Light in full wells of a noise-free pixel whose output is a fraction of full scale."""
    if settings.response == "linear":
        straight = fraction
    elif settings.response == "srgb":
        straight = light_of_srgb(fraction)
    else:
        straight = fraction**settings.response
    black = settings.black_level_dn / settings.full_scale_dn
    return (straight - black) / (1.0 - black) - settings.dark_signal_e / settings.full_well_e


def response_table(settings: CameraSettings) -> NDArray[np.uint8] | NDArray[np.uint16] | None:
    """Output for every converter value, or None for a linear camera."""
    if settings.response == "linear":
        return None
    straight = np.arange(CONVERTER_MAX + 1) / CONVERTER_MAX
    if settings.response == "srgb":
        curved = srgb_of_light(straight)
    else:
        curved = straight ** (1.0 / settings.response)
    output = np.rint(curved * settings.full_scale_dn)
    return output.astype(np.uint8 if settings.bit_depth == 8 else np.uint16)


def mosaic(linear: NDArray[Any], *, bayer: str) -> NDArray[Any]:
    """The light behind a Bayer filter: for every pixel the channel that its filter transmits.

    Args:
        linear: H x W x 3 (R, G, B), H and W even.
        bayer: colours of the first two pixels of the first two rows, such as "RGGB".

    Returns:
        H x W.

    Raises:
        InputError: the image does not have that shape.
    """
    if linear.ndim != 3 or linear.shape[2] != 3 or linear.shape[0] % 2 or linear.shape[1] % 2:
        raise InputError(
            "a Bayer mosaic needs an image of H x W x 3 with even H and W; got shape "
            f"{linear.shape}. Set bayer to 'none' or the size to even numbers."
        )
    shape = linear.shape[:2]
    return linear[_measured(shape, bayer)].reshape(shape)


def demosaiced(raw: NDArray[Any], *, bayer: str) -> NDArray[Any]:
    """Colours from a `mosaic`, H x W x 3; a pixel's two missing ones are means of its neighbours.

    The outermost pixels repeat those next to them.
    """
    return np.asarray(cv2.cvtColor(raw, getattr(cv2, f"COLOR_Bayer{bayer}2RGB")))


def after_jpeg(image: NDArray[Any], *, quality: int) -> NDArray[Any]:
    """An 8-bit RGB image after JPEG with 4:2:2 colour; the quality is libjpeg's, 1 to 100."""
    sampling = cv2.IMWRITE_JPEG_SAMPLING_FACTOR_422
    options = [cv2.IMWRITE_JPEG_QUALITY, quality, cv2.IMWRITE_JPEG_SAMPLING_FACTOR, sampling]
    _, encoded = cv2.imencode(".jpg", image[..., ::-1], options)
    return np.ascontiguousarray(np.asarray(cv2.imdecode(encoded, cv2.IMREAD_COLOR))[..., ::-1])


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
        shape: of the images that the sensor takes, and of both patterns.
        seed: random seed; it identifies the sensor.
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
        rng: random numbers of the temporal noise.
        patterns: fixed patterns of the sensor, of the raw frame's shape
            (`CameraSettings.sensor_shape`); None: a sensor without.

    Returns:
        Digital numbers of the image's shape: uint8 at 8 bits, uint16 above.

    Raises:
        InputError: image or exposure are negative or not finite.
    """
    light = np.array(linear, dtype=np.float32, order="C")
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
    if settings.bayer != "none":
        light = mosaic(light, bayer=settings.bayer)
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
    """Output of the converter, at most `full_scale`, for a mean number of electrons per pixel."""
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
        if mean.min() < few_e:
            ends = pairwise((-math.inf, min(6.0, few_e), few_e))
            # Grouped by their mean, all before one of them is drawn.
            groups = [np.flatnonzero((mean >= low) & (mean < high)) for low, high in ends]
            for few in groups:
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


def metered_exposure(
    linear: NDArray[np.floating],
    *,
    settings: CameraSettings,
    peak_fraction: float = 0.8,
    mask: NDArray[np.bool_] | None = None,
) -> float:
    """Exposure with which the peak of the brightest channel is at a fraction of full scale.

    The peak is the channel's 99.9th percentile, not its maximum, so that a single glint or noisy
    sample does not darken the frame; 307 of 640 x 480 pixels lie above it.

    Args:
        linear: light, H x W or H x W x channels, as for `expose`.
        settings: the camera; black level, dark signal and response curve are taken into account.
        peak_fraction: value of the peak in (0, 1], relative to the largest digital number.
        mask: H x W, the pixels to measure, at least one (default: all).

    Returns:
        Full wells per unit of `linear`.

    Raises:
        InputError: there is no light, or the fraction is not above the dark image.
    """
    level = float(full_wells(np.array(peak_fraction), settings))
    if level <= 0:
        raise InputError(
            f"metered_exposure(peak_fraction=...) must lie above the dark image; got peak_fraction="
            f"{peak_fraction:g}, black_level_dn={settings.black_level_dn:g} DN, dark_signal_e="
            f"{settings.dark_signal_e:g}. Raise peak_fraction or lower the black level."
        )
    image = np.asarray(linear, dtype=np.float32)
    pixels = image.reshape(image.shape[0] * image.shape[1], -1)
    if mask is not None:
        pixels = pixels[mask.reshape(-1)]
    rank = math.ceil(0.999 * len(pixels)) - 1
    peak = float(np.partition(pixels, rank, axis=0)[rank].max())
    if not 0 < peak < math.inf:
        raise InputError(
            f"metered_exposure needs light; the 99.9th percentile of the brightest channel is "
            f"{peak:g}. Give a mask that contains the spot, or set the exposure by hand."
        )
    return level / peak


Image = NDArray[np.uint8] | NDArray[np.uint16]


class CameraSensor:
    """A sensor with its fixed patterns.

    Args:
        scene: scene with the camera, window and sensitivity.
        seed: random seed of the fixed patterns (default: the scene's).
        settings: settings of the camera (default: the scene's).
    """

    def __init__(
        self, scene: Scene, *, seed: int | None = None, settings: CameraSettings | None = None
    ) -> None:
        self.settings = scene.camera if settings is None else settings
        self._exposures = scene.exposures
        shape = self.settings.sensor_shape(
            height=scene.microscope.height_px, width=scene.microscope.width_px
        )
        patterns_seed = scene.seed if seed is None else seed
        self._patterns = fixed_patterns(settings=self.settings, shape=shape, seed=patterns_seed)

    def raw(self, light: np.ndarray, *, exposure_s: float, noise_seed: Sequence[int]) -> Image:
        """The image before JPEG.

        Args:
            light: radiance, H x W x 3, mW/(mm2 sr).
            noise_seed: random seed of the temporal noise of this one image.
        """
        return expose(
            light,
            exposure=exposure_s * self._exposures.sensitivity_mm2_sr_mj,
            settings=self.settings,
            rng=np.random.default_rng(noise_seed),
            patterns=self._patterns,
        )

    def written(self, raw: Image) -> Image:
        """The image as it is in the file: after JPEG, if the camera uses JPEG."""
        quality = self.settings.jpeg_quality
        return after_jpeg(raw, quality=quality) if quality else raw

    def metered_s(self, light: np.ndarray, mask: np.ndarray) -> float:
        """Exposure time with which the peak reaches exposures.metered_peak of full scale, s.

        Args:
            light: radiance, H x W x 3, mW/(mm2 sr).
            mask: H x W, the pixels to measure; if it is empty, all pixels.
        """
        full_wells = metered_exposure(
            light,
            settings=self.settings,
            peak_fraction=self._exposures.metered_peak,
            mask=mask if mask.any() else None,
        )
        return full_wells / self._exposures.sensitivity_mm2_sr_mj
