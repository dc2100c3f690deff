"""Radiance along lines of sight is what the scene's own camera sees along them."""

import numpy as np

import scenes
from scenes.rendering.loaded_scene import radiance_along
from scenes.rendering.render import Renderer


def test_lines_of_the_scenes_own_microscope_give_its_image():
    scene = scenes.load_scene(
        None,
        (
            "source.kind=cone",
            "motion.frames=3",
            "microscope.width_px=64",
            "microscope.height_px=48",
            "microscope.scale_mm_px=0.05",
            "microscope.samples=1",
        ),
    )
    renderer = Renderer(scene)
    image = renderer.render(1).radiance
    rows, columns = np.divmod(np.arange(48 * 64), 64)
    point, direction = map(
        np.asarray, renderer.world.microscope.ray(np.stack([columns, rows], axis=-1).astype(float))
    )
    start = point - 10.0 * direction  # 10 mm above the pole, below the default pinhole
    found = radiance_along(renderer.mitsuba_scene, start=start, direction=direction)
    # Float32 lines that start elsewhere meet the wall 1 um away; at the spot's edge and on the
    # instrument's outline that decides a few pixels.
    same = np.isclose(found.reshape(image.shape), image, rtol=1e-3, atol=1e-7).all(axis=-1)
    assert same.mean() > 0.99
