"""Images of a scene without a stack on disk: one of its own, or where the tip is told to be."""

from __future__ import annotations

import numpy as np

from optics import InputError
from scenes.camera import Camera
from scenes.description import Scene
from scenes.rendering import Renderer
from scenes.stacks.photography import Photography


def render_image(
    scene: Scene, *, frame: int = 0, exposure: str | None = None, variant: str = "llvm_ad_rgb"
) -> np.ndarray:
    """One image, as `render_stack` writes it.

    Args:
        scene: the scene.
        frame: number of the frame.
        exposure: one of the scene's `exposures.kinds`; None: the first of them.
        variant: Mitsuba's variant.

    Returns:
        H x W x 3 (R, G, B), uint8 or uint16.

    Raises:
        InputError: the scene has no such frame or exposure.
        SceneError: the tip touches the wall, or the spot leaves the window.
        RendererUnavailable: Mitsuba cannot run that variant here.
    """
    kinds = scene.exposures.kinds
    kind = kinds[0] if exposure is None else exposure
    if kind not in kinds:
        raise InputError(f"exposure = {kind!r} is none of the scene's: {', '.join(kinds)}.")
    renderer = Renderer(scene, variant=variant)
    count = renderer.world.times.size
    if not 0 <= frame < count:
        raise InputError(f"frame = {frame} is not in the scene: it has 0 to {count - 1}.")
    photography = Photography(renderer.world)
    sharp = renderer.render(frame)
    duration = photography.exposure_s(kind, sharp.radiance, renderer.mask(frame, sharp))
    light = renderer.exposed(frame, sharp, exposure_s=duration).radiance
    return photography.written(
        photography.raw(light, exposure_s=duration, frame=frame, order=kinds.index(kind))
    )


class LiveCamera:
    """A scene's camera while something else moves the tip, such as a simulated robot.

    Args:
        scene: its motion is not used, but must be possible.
        variant: Mitsuba's variant.

    Raises:
        SceneError: the scene is impossible.
        RendererUnavailable: Mitsuba cannot run that variant here.
    """

    def __init__(self, scene: Scene, *, variant: str = "llvm_ad_rgb") -> None:
        self._images = Renderer(scene, variant=variant).images
        self._camera, self._seed = Camera(scene), scene.seed

    def image(
        self, tips: np.ndarray, axes: np.ndarray, *, exposure_s: float, frame: int
    ) -> np.ndarray:
        """An image while the tip moves.

        Args:
            tips: at the beginning, middle and end of the exposure, 3 x 3, mm, eye frame. The light
                is their mean by Simpson's rule.
            axes: of the beam, likewise; unit vectors from the tip towards the wall.
            exposure_s: exposure time, s.
            frame: number of the image, for its noise.

        Returns:
            H x W x 3 (R, G, B), uint8 or uint16, before JPEG.
        """
        light = sum(
            share * self._images.at(tip=tip, axis=axis, seed=frame)[0]
            for share, tip, axis in zip((1 / 6, 2 / 3, 1 / 6), tips, axes, strict=True)
        )
        seed = [self._seed, frame]
        return self._camera.raw(np.asarray(light), exposure_s=exposure_s, noise_seed=seed)
