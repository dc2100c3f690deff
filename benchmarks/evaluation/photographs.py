"""Photographs of kept linear frames, taken and measured again without rendering or files."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from benchmarks.evaluation.tracking import LITERAL, VISIBLE_ENOUGH, Way
from estimator import LiteralSettings, Spot, Stack, track
from scenes import Scene
from scenes.camera import Camera
from scenes.description import CameraSettings


class Shot(NamedTuple):
    """How a withdrawal is photographed and measured.

    Attributes:
        seed: of the camera's noise; None is a camera without noise.
        threshold: of the literal mode, grey level.
    """

    seed: int | None = None
    light: float = 1.0
    threshold: int = LiteralSettings().threshold


@dataclass(frozen=True, kw_only=True, eq=False)
class Photographer:
    """Takes a rendered withdrawal's photographs and measures their spots.

    Attributes:
        stack: rendered with `exposures.keep_linear`.
    """

    scene: Scene
    stack: Stack

    @property
    def readings(self) -> np.ndarray:
        """d_r since contact of every frame, mm."""
        d = np.array([row.d_mm for row in self.stack.exposed(LITERAL.exposure)])
        return d - d[0]

    def measure(self, way: Way, shots: Sequence[Shot]) -> list[np.ndarray]:
        """e1' of every frame, px, for each shot; NaN where no spot counts.

        Args:
            shots: any number; frames are read once for all.
        """
        light = [self.stack.linear(row) for row in self.stack.exposed(way.exposure)]
        return [self._semi_minor(way, shot, light) for shot in shots]

    def _semi_minor(self, way: Way, shot: Shot, light: Sequence[np.ndarray]) -> np.ndarray:
        rows, settings = self.stack.exposed(way.exposure), way.settings
        if isinstance(settings, LiteralSettings):
            settings = replace(settings, threshold=shot.threshold)
        start = (rows[0].half_max_x_px, rows[0].half_max_y_px) if way.clicked else None
        found = track(self._images(way, shot, light), settings, start=start)
        return np.array(
            [
                spot.semi_minor_px
                if isinstance(spot, Spot) and row.visible_fraction >= VISIBLE_ENOUGH
                else np.nan
                for row, spot in zip(rows, found, strict=True)
            ]
        )

    def _images(self, way: Way, shot: Shot, light: Sequence[np.ndarray]) -> Iterator[np.ndarray]:
        quiet = None if shot.seed is not None else _noise_free(self.scene.camera)
        seed = shot.seed or 0
        camera = Camera(self.scene, seed=seed, settings=quiet)
        for row, linear in zip(self.stack.exposed(way.exposure), light, strict=True):
            raw = camera.raw(
                linear, exposure_s=shot.light * row.exposure_s, noise_seed=[seed, row.frame]
            )
            yield camera.written(raw)


def _noise_free(camera: CameraSettings) -> CameraSettings:
    """The same camera with so many electrons that their number has no noise."""
    quiet = {"full_well_e": 1e12, "read_noise_e": 0.0, "dark_signal_e": 0.0}
    return camera.model_copy(update=quiet | {"prnu": 0.0, "dsnu_e": 0.0})
