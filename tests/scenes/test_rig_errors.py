"""What a rig states wrongly, and a clear layer over the wall: images and labels keep the truth."""

import json
import math

import numpy as np
import pytest

from eyespot.formats.rig import read_rig
from eyespot.formats.stack import read_stack
from eyespot.scenes import Scene, SceneError, render_stack
from eyespot.scenes.world.labels import spot_labels
from eyespot.scenes.world.motion import kinematics
from eyespot.scenes.world.world import World
from tests.support.drawn.scene_tables import BARE, scene_of

SMALL = {"width_px": 160, "height_px": 120, "scale_mm_px": 0.0268, "pinhole_height_mm": 200.0}
ERRORS = {
    "scale": 0.01,
    "robot_scale": 0.02,
    "pinhole_height_mm": 5.0,
    "eye_radius_mm": 0.3,
    "touch_mm": 0.03,
    "clock_s": 0.05,
    "seed": 4,
}


def scene(**parts) -> Scene:
    motion = {"kind": "withdrawal", "frames": 2, "travel_mm": 3.0}
    return scene_of(BARE, {"microscope": SMALL, "motion": motion}, parts)


def test_the_rig_of_a_stack_is_wrong_as_drawn_and_its_images_and_labels_are_not(tmp_path):
    render_stack(scene(), tmp_path / "right")
    render_stack(scene(rig_errors=ERRORS), tmp_path / "wrong")
    right, wrong = read_stack(tmp_path / "right"), read_stack(tmp_path / "wrong")
    assert right.labels == wrong.labels
    assert all((right.image(row) == wrong.image(row)).all() for row in right.labels)
    stated, true = (
        json.loads((tmp_path / name / "microscope.json").read_text()) for name in ("wrong", "right")
    )
    errors = scene(rig_errors=ERRORS).rig_errors.drawn()
    assert stated["scale_mm_px"] == pytest.approx(true["scale_mm_px"] * (1 + errors.scale))
    for key in ("pinhole_height_mm", "eye_radius_mm"):
        assert stated[key] == pytest.approx(true[key] + getattr(errors, key))
    # The focal length that belongs to the stated numbers: a reader checks that they agree.
    depth = stated["pinhole_height_mm"] + stated["eye_radius_mm"]
    assert stated["camera_matrix"][0][0] == pytest.approx(depth / stated["scale_mm_px"])
    assert stated["principal_point_px"] == true["principal_point_px"]
    rig, exact = (read_rig(tmp_path / name / "rig.toml") for name in ("wrong", "right"))
    assert rig.microscope.scale_sigma == 0.01 and exact.microscope.scale_sigma == 0
    assert rig.microscope.id == "rig 4, 0.0268 mm/px, 1 %" and not exact.microscope.id
    assert rig.robot.scale_sigma == 0.02 and rig.robot.clock_sigma_s == 0.05
    assert rig.wall.radius_sigma_mm == 0.3 and rig.microscope.pinhole_height_sigma_mm == 5.0
    first = right.labels[0].d_mm
    assert rig.robot.touch == pytest.approx((first + errors.touch_mm, 0.03))
    # The robot's way, and when it begins to move.
    rows, true_rows = (stack.kinematics() for stack in (wrong, right))
    way, true_way = (
        np.linalg.norm([row[k][-1] - row[k][0] for k in ("x_mm", "y_mm", "z_mm")])
        for row in (rows, true_rows)
    )
    assert way == pytest.approx(true_way * (1 + errors.robot_scale), rel=1e-5)  # rounded to 1 nm
    assert rows["time_s"][0] - true_rows["time_s"][0] == pytest.approx(errors.clock_s, abs=2e-6)


def test_drawn_errors_have_the_stated_spread_and_zero_states_the_truth():
    drawn = np.array(
        [scene(rig_errors={**ERRORS, "seed": seed}).rig_errors.drawn() for seed in range(400)]
    )
    sigmas = [ERRORS[name] for name in scene().rig_errors.drawn()._fields]
    # Of 400 normal draws the RMS is off by 1 / sqrt(800) = 3.5 %, the mean by 5 % of sigma.
    np.testing.assert_allclose(np.sqrt(np.mean((drawn / sigmas) ** 2, axis=0)), 1, atol=0.14)
    np.testing.assert_allclose(np.mean(drawn / sigmas, axis=0), 0, atol=0.2)
    assert not any(scene().rig_errors.drawn())
    still = scene()
    true = kinematics(still, World(still).motion)
    assert np.array_equal(true, kinematics(scene(rig_errors={"seed": 9}), World(still).motion))


def test_an_error_of_a_pinhole_is_refused_behind_a_viewing_lens():
    viewing = {"eye": "navarro", "lens": "flat"}
    with pytest.raises(ValueError, match=r"rig_errors.scale .*Set it to 0"):
        scene(viewing=viewing, rig_errors={"scale": 0.01})


@pytest.mark.parametrize("incidence", [0.0, 30.0])
def test_a_tip_at_contact_touches_the_clear_layer_and_the_label_has_the_way_to_it(incidence):
    layer, r = 0.25, 11.5
    spot = {"eccentricity_mm": 2.0, "incidence_deg": incidence, "incidence_azimuth_deg": 60.0}
    world = World(scene(spot=spot, phantom={"clear_layer_mm": layer}))
    tip, axis = (np.asarray(v[0]) for v in (world.truth.beam.tip, world.truth.beam.axis))
    # The rim's farthest point from the centre of the eye lies on a sphere of the radius r - layer.
    ahead = tip @ axis
    reach = math.hypot(ahead, np.linalg.norm(tip - ahead * axis) + world.tip_radius)
    # The rim has 64 points: 0.25 mm * (1 - cos(pi / 64)) * sin(30 deg) = 0.15 um too far at most.
    assert reach == pytest.approx(r - layer, abs=2e-4)
    labels = spot_labels(world, 1)
    # A chord from the wall to the concentric sphere, by Pythagoras.
    i = math.radians(incidence)
    inside = r * math.cos(i) - math.sqrt((r - layer) ** 2 - (r * math.sin(i)) ** 2)
    assert labels["d_mm"] - labels["surface_mm"] == pytest.approx(inside, abs=1e-9)
    assert "surface_mm" not in spot_labels(World(scene(spot=spot)), 1)


def test_the_layer_of_a_tilted_plane_is_as_thick_as_stated():
    phantom = {"kind": "plane", "tilt_deg": 20.0, "clear_layer_mm": 0.25}
    world = World(scene(phantom=phantom, spot={"incidence_deg": 0.0}))
    labels = spot_labels(world, 1)  # the beam is square to the plane
    assert labels["d_mm"] - labels["surface_mm"] == pytest.approx(0.25, abs=1e-9)


def test_a_tip_in_the_layer_is_refused():
    motion = {"kind": "withdrawal", "start_mm": 0.2, "frames": 2, "travel_mm": 1.0}
    with pytest.raises(SceneError, match="deep in the wall"):
        World(scene(motion=motion, phantom={"clear_layer_mm": 0.25})).check()


def test_the_rig_of_a_stack_with_a_layer_reads_both_distances(tmp_path):
    stack = render_stack(scene(phantom={"clear_layer_mm": 0.25}), tmp_path / "stack")
    rig = read_rig(tmp_path / "stack" / "rig.toml")
    assert rig.stated.clear_layer_mm == 0.25 and rig.stated.clear_layer_sigma_mm == 0
    assert stack.labels[1].surface_mm < stack.labels[1].d_mm
