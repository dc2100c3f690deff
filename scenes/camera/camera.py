"""Camera: exposes linear frames with the sensor of a scene."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from scenes.camera.exposure import expose, fixed_patterns
from scenes.camera.metering import metered_exposure
from scenes.camera.output import after_jpeg
from scenes.description import CameraSettings, Scene

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
