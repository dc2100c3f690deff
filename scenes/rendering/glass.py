"""Images by photons through the lens as real glass, which know nothing of its irradiance table.

Import after `load_mitsuba`.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import mitsuba as mi
import numpy as np

import optics
from scenes.description import Scene
from scenes.rendering.build import mitsuba_dict, pose_parameters
from scenes.rendering.photons import photon_image
from scenes.world import LensLight, World


def glass_images(
    scene: Scene, *, frame: int, photons_per_pixel: int, seeds: Iterable[int]
) -> np.ndarray:
    """Images of a frame by Mitsuba's particle tracer and its own glass, seeds x H x W.

    Args:
        scene: of kind "photons", with a uniform wall.
        frame: of its motion.
        photons_per_pixel: leaving the core.
        seeds: of independent images.
    """
    world = World(scene)
    # Photons do not use the table, and a real one takes half a minute to compute.
    nothing: Any = np.zeros(())
    cells: Any = np.zeros((2, 2, 2))
    empty = optics.IrradianceTable(cells, nothing + world.medium_index, nothing, nothing)
    world.light = LensLight(empty, 1.0)
    loaded = mi.load_dict(mitsuba_dict(world, uniform=np.zeros(3)))
    (tip,), (axis,) = world.motion.at(world.times[frame : frame + 1])
    parameters = mi.traverse(loaded)
    parameters.update(pose_parameters(scene, tip=tip, axis=axis, apex=tip))
    images = [photon_image(loaded, photons_per_pixel=photons_per_pixel, seed=s) for s in seeds]
    return np.stack(images)[..., 0]
