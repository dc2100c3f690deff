"""One image of a scene, without a stack on disk."""

from __future__ import annotations

import numpy as np

from optics import InputError
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
