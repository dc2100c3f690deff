"""Chooses the exposure times of a stack, and writes its images and labels."""

from __future__ import annotations

from typing import Any

import numpy as np

from estimator.files import FrameLabels, StackWriter
from scenes.camera import Camera
from scenes.world import World, longest_exposure, paper_exposure


def file_name(world: World, frame: int, order: int) -> str:
    """File name, within the stack, of a frame's image with the order-th kind of exposure."""
    return f"frames/{frame * len(world.scene.exposures.kinds) + order:06d}.png"


class Photography:
    """Exposes and writes the frames of one stack.

    Args:
        world: the stack's scene and everything derived from it.

    Attributes:
        paper_exposure_s: fixed exposure time of the `paper` frames.
    """

    def __init__(self, world: World) -> None:
        self._world = world
        self._camera = Camera(world.scene)
        self.paper_exposure_s = paper_exposure(world)

    def exposure_s(self, kind: str, light: np.ndarray, mask: np.ndarray) -> float:
        """Exposure time; for `metered` it depends on the light within the mask.

        It is never longer than the time between two frames, even if a metered frame is then dark.
        """
        if kind == "paper":
            return self.paper_exposure_s
        return min(self._camera.metered_s(light, mask), longest_exposure(self._world.scene))

    def raw(self, light: np.ndarray, *, exposure_s: float, frame: int, order: int) -> np.ndarray:
        """The camera's image of a frame with the order-th kind of exposure, before JPEG."""
        seed = [self._world.scene.seed, frame, order]
        return self._camera.raw(light, exposure_s=exposure_s, noise_seed=seed)

    def written(self, raw: np.ndarray) -> np.ndarray:
        """The image as it is in the file: after JPEG, if the camera uses JPEG."""
        return self._camera.written(raw)

    def write(
        self,
        writer: StackWriter,
        light: np.ndarray,
        *,
        order: int,
        exposure_s: float,
        mask: np.ndarray,
        labels: dict[str, Any],
    ) -> None:
        """Expose a frame with the order-th kind of exposure, and write it with its labels."""
        scene, frame = self._world.scene, labels["frame"]
        raw = self.raw(light, exposure_s=exposure_s, frame=frame, order=order)
        saturated = np.any(raw[mask] >= scene.camera.full_scale_dn, axis=-1)
        row = FrameLabels(
            file_name=file_name(self._world, frame, order),
            mask_file_name=f"masks/{frame:06d}.png",
            exposure=scene.exposures.kinds[order],
            exposure_s=exposure_s,
            saturated_fraction=float(saturated.mean()) if saturated.size else 0.0,
            **labels,
        )
        writer.add(
            self.written(raw),
            row,
            np.uint8(255) * mask if order == 0 else None,
            light if scene.exposures.keep_linear else None,
        )
