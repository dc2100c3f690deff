"""What moves beside the tip: the view, the eyeball, the source's power."""

import numpy as np
import pytest
from pydantic import ValidationError

from eyespot import scenes
from eyespot.scenes.rendering.render import Renderer
from eyespot.scenes.world.world import World
from tests.support.drawn.scene_tables import scene_of

pytestmark = pytest.mark.usefixtures("fast_compilation")

SCALE = 0.04
_MICROSCOPE = {"width_px": 97, "height_px": 97, "scale_mm_px": SCALE, "pinhole_height_mm": np.inf}
_STILL = {
    "phantom": {"wall": "retina", "indirect": "closed form"},
    "source": {"kind": "cone"},
    "spot": {"eccentricity_mm": 0.0, "incidence_deg": 0.0},
    # At constant distance for two seconds, a frame each: the light is the same in all frames.
    "motion": {"kind": "scan", "distance_mm": 2.0, "trocar_mm": np.inf}
    | {"length_mm": 2e-5, "speed_mm_s": 1e-5},
    "clocks": {"camera_hz": 1.0},
    "instrument": {"visible": False},
    "microscope": _MICROSCOPE,
}


_DARK = {"source": {"power_mw": 1e-6}}


def scene(*layers):
    return scene_of(_STILL, *layers)


def renderer(unrest, *layers):
    return Renderer(scene({"unrest": unrest}, *layers))


@pytest.fixture(scope="module")
def still():
    """The frame in which nothing moves; all are the same, as the light keeps its place."""
    return Renderer(scene()).render(1).radiance


@pytest.fixture(scope="module")
def dark():
    """The same without the beam."""
    return Renderer(scene(_DARK)).render(1).radiance


def test_a_drift_moves_the_image_and_the_labels(still):
    # 2 px to the right and 1 px up after one second.
    drift = {"drift_mm_s": (2 * SCALE, SCALE)}
    moved = renderer(drift)
    seen = moved.render(1).radiance
    np.testing.assert_allclose(seen[1:-3, 3:-1], still[2:-2, 1:-3], rtol=1e-4)
    centres = np.asarray(moved.world.truth.half_max.centre)
    np.testing.assert_allclose(centres[1] - centres[0], [2.0, -1.0], atol=1e-3)


def test_a_shake_is_new_in_each_frame_and_has_its_size():
    def views_of(seed):
        often = {"clocks": {"camera_hz": 100.0}, "unrest": {"shake_px": 2.0, "seed": seed}}
        world = World(scene(often))
        return world.unrest.views(world.times)

    views = views_of(3)
    # 400 draws: a standard error of 0.07 px.
    assert views.size >= 400
    assert np.std(views) == pytest.approx(2.0, abs=0.3)
    assert not np.allclose(views_of(4), views)


def test_an_eyeball_that_turns_a_quarter_around_the_view_turns_its_picture_only(still):
    # Counterclockwise as seen from above, which is how the image is seen.
    turned = renderer({"rotation_deg_s": (0.0, 0.0, 90.0)})
    seen = turned.render(1).radiance
    difference = np.abs(seen - np.rot90(still)).mean() / still.mean()
    # The map's texels, 0.01 mm, are interpolated at other places.
    assert difference < 0.01
    assert np.abs(seen - still).mean() / still.mean() > 0.02
    np.testing.assert_array_equal(
        np.asarray(turned.world.truth.half_max.centre),
        np.asarray(World(scene()).truth.half_max.centre),
    )


def test_a_sideways_turn_moves_the_picture_by_its_arc(dark):
    # Around +Y the retina below moves towards -X: 2 pixels of arc at the pole.
    radius = scenes.Scene().phantom.radius_mm
    rate = -np.degrees(2 * SCALE / radius)
    turned = renderer({"rotation_deg_s": (0.0, rate, 0.0)}, _DARK)
    seen, still = turned.render(1).radiance[..., 1], dark[..., 1]
    middle = slice(28, 69)
    errors = [
        np.abs(seen[middle, middle] - np.roll(still, shift, axis=1)[middle, middle]).mean()
        for shift in range(-4, 5)
    ]
    assert np.argmin(errors) - 4 == 2


def test_the_power_swings_all_light_of_the_source():
    no_lamp = {"microscope": {"illumination_mw_mm2": 0.0}}
    swinging = renderer({"power_swing": 0.05, "seed": 1}, no_lamp)
    powers = [swinging.world.unrest.at(k, 0.0).power for k in range(2)]
    assert powers[0] != powers[1]
    still = renderer({}, no_lamp).render(0).radiance
    for frame in (1, 0):
        light = swinging.render(frame).radiance
        # float32 places a point of the wall, and so the cone's edge, to 1e-6 mm. The edge is as
        # wide as a sample, 0.003 mm or more, so that its light is known to 3e-4 of the step.
        np.testing.assert_allclose(light, powers[frame] * still, rtol=1e-4, atol=1e-3 * still.max())


@pytest.mark.parametrize("phantom", [{"kind": "plane"}, {"stretch": (1.1, 1.0)}])
def test_only_a_sphere_turns(phantom):
    with pytest.raises(ValidationError, match="rotation_deg_s turns a spherical eyeball"):
        scene({"phantom": phantom, "unrest": {"rotation_deg_s": (1.0, 0.0, 0.0)}})


def test_labels_say_what_moved(tmp_path):
    unrest = {"shake_px": 1.0, "power_swing": 0.05, "rotation_deg_s": (0, 0, 3.0)}
    stack = scenes.render_stack(scene({"unrest": unrest}), tmp_path / "stack")
    label = stack.labels[-1]
    assert label.eye_turn_z_deg == pytest.approx(3.0 * label.time_s)
    assert abs(label.relative_power - 1) < 0.3 and label.relative_power != 1
    centre = (_MICROSCOPE["width_px"] - 1) / 2
    # The spot lies on the axis, so its centre is that of the window, shaken.
    assert label.half_max_x_px == pytest.approx(centre + label.view_x_px, abs=1e-3)
    assert "red_shift_x_px" not in label.row()


def test_an_eyeball_that_turns_makes_no_noise_on_the_terminal(capfd):
    turned = renderer({"rotation_deg_s": (0.0, 30.0, 0.0)})
    (tip,), (axis,) = turned.world.motion.at(np.zeros(1))
    for time in np.linspace(0.0, 0.3, 60):
        turned.images.place(tip=tip, axis=axis, moment=turned.world.unrest.at(0, time))
    assert capfd.readouterr() == ("", "")
