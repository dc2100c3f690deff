"""Camera: exposes linear frames with the sensor of a scene, and meters the exposure time."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from optics import InputError
from scenes.camera.exposure import expose, fixed_patterns
from scenes.camera.output import after_jpeg
from scenes.camera.response import full_wells
from scenes.description import CameraSettings, Scene


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
        peak_fraction: value of the peak, relative to the largest digital number.
        mask: H x W, the pixels to measure (default: all).

    Returns:
        Full wells per unit of `linear`.

    Raises:
        InputError: there is no light or no pixel to measure, or the fraction is out of range.
    """
    if not 0 < peak_fraction <= 1:
        raise InputError(
            f"metered_exposure(peak_fraction=...) must lie in (0, 1]; got {peak_fraction:g}."
        )
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
        if mask.shape != image.shape[:2]:
            raise InputError(
                f"metered_exposure(mask=...) must have the image's height and width "
                f"{image.shape[:2]}; got {mask.shape}."
            )
        pixels = pixels[mask.reshape(-1)]
    if len(pixels) == 0:
        raise InputError("metered_exposure(mask=...) must contain at least one pixel; it is empty.")
    rank = math.ceil(0.999 * len(pixels)) - 1
    peak = float(np.partition(pixels, rank, axis=0)[rank].max())
    if not 0 < peak < math.inf:
        raise InputError(
            f"metered_exposure needs light; the 99.9th percentile of the brightest channel is "
            f"{peak:g}. Give a mask that contains the spot, or set the exposure by hand."
        )
    return level / peak


Image = NDArray[np.uint8] | NDArray[np.uint16]


class Camera:
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
            exposure_s: exposure time, s.
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
