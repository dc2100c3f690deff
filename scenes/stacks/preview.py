"""One small frame of a scene, for a quick look."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from estimator.files import written_whole
from scenes.camera import Camera
from scenes.description import Scene
from scenes.rendering import images_of
from scenes.world import World

_SHRINK = 2


def write_preview(scene: Scene, path: Path, *, variant: str = "llvm_ad_rgb") -> None:
    """Render `preview` into a PNG file, which must not exist."""
    with written_whole(path) as partial:
        image = preview(scene, variant=variant)
        _, encoded = cv2.imencode(".png", image[..., ::-1])
        partial.write_bytes(encoded.tobytes())


def preview(scene: Scene, *, variant: str = "llvm_ad_rgb") -> np.ndarray:
    """The frame in the middle of the motion at half of its size, with one sample per pixel.

    It has the metered exposure and the sensor's noise, but no motion blur and no JPEG. The spot may
    leave the window, unlike in a stack.

    Args:
        scene: the scene.
        variant: Mitsuba's variant.

    Returns:
        H/2 x W/2 x 3 (R, G, B), uint8 or uint16.

    Raises:
        SceneError: the tip touches the wall.
        RendererUnavailable: Mitsuba cannot run that variant here.
    """
    world = World(scene)
    (tip,), (axis,) = world.motion.at(world.times[[world.times.size // 2]])
    small = World(_small(scene))
    radiance, _ = images_of(small, variant=variant).at(tip=tip, axis=axis, seed=0)
    camera = Camera(small.scene)
    exposure_s = camera.metered_s(radiance, np.ones(radiance.shape[:2], bool))
    return camera.raw(radiance, exposure_s=exposure_s, noise_seed=[scene.seed])


def _small(scene: Scene) -> Scene:
    """The same field of view with fewer pixels; even numbers, as a Bayer mosaic needs."""
    large = scene.microscope
    width, height = (
        max(16, size // _SHRINK // 2 * 2) for size in (large.width_px, large.height_px)
    )
    scale = large.scale_mm_px * max(large.width_px / width, large.height_px / height)
    x, y = large.window_offset_px
    fewer = large.scale_mm_px / scale
    small = {
        "width_px": width,
        "height_px": height,
        "scale_mm_px": scale,
        "window_offset_px": (fewer * x, fewer * y),
        "samples": 1,
    }
    return scene.model_copy(update={"microscope": large.model_copy(update=small)})
