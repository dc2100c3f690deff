"""Images by photons through the lens as glass, without its irradiance table.

Import after `load_mitsuba`.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import mitsuba as mi
import numpy as np

import optics
from scenes.description.scene import Scene
from scenes.rendering.build import mitsuba_dict, mover
from scenes.rendering.photons import photon_image
from scenes.world.world import LensLight, World


def glass_images(
    scene: Scene, *, frame: int, photons_per_pixel: int, seeds: Iterable[int]
) -> np.ndarray:
    """Images of a frame by Mitsuba's particle tracer and glass, seeds x H x W.

    Args:
        scene: a scene of source.kind "photons" with a uniform wall.
        photons_per_pixel: number of photons that leave the core, per pixel.
        seeds: random seeds, one per image.
    """
    world = World(scene)
    # Photons do not use the table, which would take half a minute to compute.
    nothing: Any = np.zeros(())
    cells: Any = np.zeros((2, 2, 2))
    empty = optics.IrradianceTable(cells, nothing + world.medium_index, nothing, nothing)
    world.light = LensLight(empty, 1.0)
    loaded = mi.load_dict(mitsuba_dict(world, uniform=np.zeros(3)))
    (tip,), (axis,) = world.motion.at(world.times[frame : frame + 1])
    mover(scene, loaded)(tip, axis)
    images = [photon_image(loaded, photons_per_pixel=photons_per_pixel, seed=s) for s in seeds]
    return np.stack(images)[..., 0]
