"""What makes frames fast changes nothing: pixels are rendered again only where they change."""

from typing import Any

import numpy as np
import pytest

from eyespot.scenes import Scene, load_mitsuba
from eyespot.scenes.rendering.render import images_of
from eyespot.scenes.world.world import World
from tests.support.drawn.scene_tables import scene_of


def scene(**parts: Any) -> Scene:
    """A withdrawal of the ideal cone with its instrument, in a small window."""
    window = {"width_px": 200, "height_px": 150, "scale_mm_px": 0.025}
    parts.setdefault("motion", {"travel_mm": 4.0, "frames": 3})
    return scene_of({"source": {"kind": "cone"}, "microscope": window}, parts)


@pytest.mark.parametrize(
    "settings",
    [
        scene(),
        scene(spot={"eccentricity_mm": 3.0, "incidence_deg": 0.0}, instrument={"gauge": 20}),
        scene(
            second_tool={"visible": True, "tip_mm": [-0.8, 0.3, -10.8]},
            microscope={"pinhole_height_mm": 200.0, "samples": 9},
        ),
        scene(
            phantom={"kind": "plane", "tilt_deg": 20.0},
            microscope={"pinhole_height_mm": np.inf, "light": "ambient", "vignetting": 0.3},
        ),
        scene(
            microscope={"distortion": [-0.2, 0.3, 0.02, -0.03, 0.5], "samples": 1},
            motion={"kind": "hand", "duration_s": 0.2, "distance_mm": 1.0},
        ),
    ],
    ids=["plain", "square", "second tool", "telecentric plane", "distorted hand"],
)
def test_a_frame_of_which_only_the_changes_are_rendered_is_the_whole_frame(settings):
    world = World(settings)
    images = images_of(world, variant="llvm_ad_rgb")
    seen = []
    for tip, axis in zip(*world.motion.at(world.times), strict=True):
        radiance, wall = images.at(tip=tip, axis=axis, seed=0)
        # Mitsuba's own loop over all pixels, with the tip where it is now.
        whole = np.array(load_mitsuba().render(images.mitsuba_scene))
        # Single precision: sums in another order, places on the film that differ in the last bit.
        np.testing.assert_allclose(radiance, whole[..., :3], rtol=0, atol=1e-6 * whole.max())
        np.testing.assert_allclose(wall, whole[..., 3], atol=1e-6)
        seen.append(wall.min())
    assert min(seen) == 0, "no instrument in view"
