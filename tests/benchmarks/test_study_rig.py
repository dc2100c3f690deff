"""A study answers for a rig: its scene, its keys, and what cannot be rendered is said before."""

import math

import pytest

from eyespot import scenes
from eyespot.benchmarks.study import geometry_of, require_possible
from eyespot.benchmarks.workspace import scene_of_rig, workspace_of_scene
from eyespot.formats.inputs import InputError
from eyespot.formats.rig import Rig
from eyespot.scenes import Scene
from eyespot.scenes.description.scene_keys import OutsideWindow
from eyespot.scenes.world.world import World

NUMBERS = {
    "microscope.width_px": 800,
    "microscope.height_px": 600,
    "microscope.scale_mm_px": 0.01,
    "microscope.pinhole_height_mm": 175.0,
    "wall.radius_mm": 10.8,
    "wall.medium": "vitreous",
    "instrument.core_radius_mm": 0.1,
    "instrument.fibre_diameter_mm": 0.4,
    "beam.numerical_aperture": 0.12,
    "workspace.tilt_deg": [0.0, 20.0],
    "workspace.distance_mm": [1.0, 4.0],
    "robot.eye_from_robot": [0.0, 0.0, 0.0, 1.0],
    "camera.noise": {
        "full_well_e": 9000.0,
        "read_noise_e": 5.0,
        "black_level_dn": 4.0,
        "bit_depth": 8,
    },
}


def scene_of(rig: Rig) -> Scene:
    return scenes.changed(Scene(), scene_of_rig(rig)[0])


def test_the_scene_of_a_rig_has_its_numbers_and_the_rest_is_named():
    changes, unread = scene_of_rig(Rig().changed(NUMBERS))
    assert unread == ["robot.eye_from_robot"]
    scene = scenes.changed(Scene(), changes)
    assert (scene.microscope.width_px, scene.microscope.pinhole_height_mm) == (800, 175.0)
    assert (scene.phantom.radius_mm, scene.source.medium) == (10.8, "vitreous")
    assert (scene.spot.incidence_deg, scene.camera.full_well_e) == (20.0, 9000.0)
    cone = World(scene).cone
    # Snell: the sine shrinks by the index; the light is as wide as the core at the tip.
    assert math.sin(cone.half_angle) == pytest.approx(0.12 / 1.336, rel=1e-9)
    assert -cone.apex_offset * math.tan(cone.half_angle) == pytest.approx(0.1, rel=1e-8)


def test_a_study_works_over_the_workspace_and_refuses_what_is_outside_of_the_eye():
    rig = Rig().changed(NUMBERS)
    scene = scene_of(rig)
    space = workspace_of_scene(scene, rig, geometry_of(scene))
    assert (space.distance_mm, space.tilt_deg) == ((1.0, 4.0), (0.0, 20.0))
    assert space.eccentricity_mm == pytest.approx((0.0, 0.7 * 10.8))
    small = scenes.changed(scene, {"phantom.radius_mm": 2.1})
    with pytest.raises(InputError, match=r"distance_mm reaches 4 mm.*may reach 3\.9 mm"):
        workspace_of_scene(small, rig, geometry_of(small))


def test_a_spot_that_leaves_the_window_is_said_before_anything_is_rendered():
    wide_beam = {"beam.numerical_aperture": 0.45, "microscope.scale_mm_px": 0.004}
    rig = Rig().changed({**NUMBERS, **wide_beam})
    far = {"motion.start_mm": 1.0, "motion.travel_mm": 4.0, "spot.eccentricity_mm": 2.0}
    scene = scenes.changed(scene_of(rig), far)
    fine = scenes.changed(scene, {"motion.travel_mm": 1.0})
    with pytest.raises(OutsideWindow, match=r"in 1 of 2 trials .*microscope\.width_px=") as raised:
        require_possible({"fine": fine, "far": scene})
    # The nearest window that works does work.
    width, height = raised.value.needed_px
    wide = {"microscope.width_px": width, "microscope.height_px": height}
    require_possible({"far": scenes.changed(scene, wide)})
    narrow = {**wide, "microscope.height_px": height - 32}
    with pytest.raises(InputError, match="leaves the"):
        require_possible({"far": scenes.changed(scene, narrow)})
