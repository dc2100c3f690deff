"""`eyespot fit` chooses the model, and a lens to start from, by what was measured alone."""

import math
import tomllib
from dataclasses import replace

import numpy as np
import pytest
import tomli_w

from eyespot import optics, scenes
from eyespot.calibration.command.fitting import chosen_model
from eyespot.calibration.command.lens_guess import guessed_lenses
from eyespot.calibration.pixels.data import footage_of
from eyespot.calibration.pixels.lens_light import cap_of, cap_shape, cap_slopes
from eyespot.calibration.recorded_trial import recorded_trial
from eyespot.calibration.spots.cone_trials import Prior
from eyespot.estimator.recording import Recording
from eyespot.formats.spot import Spot
from eyespot.optics.wall_light.lens_flux import lens_parameters
from tests.support.drawn.drawn_sets import with_false_labels
from tests.support.drawn.scene_tables import scene_of

LENS = {"kind": "lens", "lens": "paper-candidate", "medium": "air"}
CONE = {"kind": "cone", "cone_k": 20.0, "cone_apex_offset_mm": -5.117}


@pytest.fixture(scope="module")
def stack(tmp_path_factory):
    folder = tmp_path_factory.mktemp("stacks")

    def render(name, source, **motion):
        if not (folder / name).exists():
            scene = {
                "source": source,
                "motion": {"frames": 9, **motion},
                "microscope": {"width_px": 320, "height_px": 240, "scale_mm_px": 0.0134},
                "exposures": {"kinds": ["paper", "metered"]},
            }
            scenes.render_stack(scene_of(scene), folder / name)
        return folder / name

    return render


@pytest.mark.parametrize(
    ("source", "other", "model", "edges"),
    [(LENS, CONE, "lens", "soft"), (CONE, LENS, "cone", "sharp")],
)
def test_the_model_follows_the_spots_and_not_the_labels(
    stack, tmp_path, source, other, model, edges
):
    true = stack(model, source)
    # Of the copy, the description has another source, and the labels are all wrong.
    false = with_false_labels(true, tmp_path / "false")
    description = tomllib.loads((false / "stack.toml").read_text())
    description["scene"]["source"] |= {"kind": other["kind"]}
    (false / "stack.toml").write_text(tomli_w.dumps(description))
    for folder in (true, false):
        chosen, reason = chosen_model([recorded_trial(folder)])
        assert chosen == model
        assert edges in reason


@pytest.mark.parametrize(
    ("edge", "model"),
    [
        (lambda radius: 4.0, "cone"),
        (lambda radius: 0.25 * radius, "lens"),
        (lambda radius: 9.0, "lens"),  # no camera is so far out of focus
        (lambda radius: 4.0 if radius < 22 else 8.0, "lens"),
    ],
)
def test_a_narrow_edge_as_wide_in_all_frames_is_the_cameras_blur(stack, edge, model):
    one = recorded_trial(stack("cone", CONE))
    records = [
        replace(own, result=replace(spot, edge_width_px=edge(spot.semi_minor_px)))
        for own in one.records
        if isinstance(spot := own.result, Spot)
    ]
    # Of radii of 20 to 38 px, 4 px are more than `SOFT_EDGE`.
    assert chosen_model([one._replace(records=records)])[0] == model


def test_a_blur_is_the_cameras_though_the_robot_rests_for_most_frames(stack):
    one = recorded_trial(stack("cone", CONE))
    records = [
        replace(own, result=replace(spot, edge_width_px=4.0, semi_minor_px=radius))
        for own in one.records
        if isinstance(spot := own.result, Spot)
        for radius in [min(spot.semi_minor_px, 31.0)]
    ]
    assert chosen_model([one._replace(records=records)])[0] == "cone"


def test_of_two_exposures_the_metered_one_is_measured(stack):
    folder = stack("cone", CONE)
    usual, metered = (recorded_trial(Recording.open(folder, exposure=e)) for e in (None, "metered"))
    np.testing.assert_array_equal(
        usual.trial.ellipses.semi_minor, metered.trial.ellipses.semi_minor
    )


DOME = lens_parameters(optics.load_lens("dome"))  # another lens on the same fibre
ANY_PRIORS = {
    "core_radius": Prior(0.225, 0.0375),
    "aperture_radius": Prior(0.265, 0.03),
    "sag": Prior(0.0, 0.125),
}
# A flat end of the same fibre, and what is known of any: the start of a fit that knows nothing.
ANY = {name: prior.mean for name, prior in ANY_PRIORS.items()}
ANY |= {"rim_height": 0.0, "glue_index": 1.49, "numerical_aperture": 0.05}


# A known fibre goes the same way with fewer unknowns.
@pytest.mark.slow
@pytest.mark.parametrize(("kind", "priors"), [(ANY, ANY_PRIORS), (DOME, {})])
def test_a_lens_to_start_from_is_guessed_within_the_steps_of_the_grid(stack, kind, priors):
    shown = stack("lens", LENS)
    footage = footage_of(shown)
    guess = next(guessed_lenses(recorded_trial(shown), footage, kind, priors))
    # The preset: a flat end, numerical aperture 0.10; neighbours on the grid are a third away.
    assert guess["numerical_aperture"] == pytest.approx(0.10, rel=0.3)
    assert guess["sag"] < 0.05


@pytest.mark.slow  # the same way as for a flat end, with another stack
def test_a_high_drop_is_guessed_although_its_spots_have_no_edge(stack, tmp_path):
    drop = {"core_radius": 0.21, "aperture_radius": 0.235, "glue_index": 1.49, "sag": 0.12}
    drop |= {"numerical_aperture": 0.15, "glue_length": 0.12}
    (tmp_path / "drop.toml").write_text(tomli_w.dumps({"schema": 1, "lens": drop}))
    shown = stack("drop", {**LENS, "lens": str(tmp_path / "drop.toml")}, travel_mm=5.0)
    footage = footage_of(shown)
    guess = next(guessed_lenses(recorded_trial(shown), footage, ANY, ANY_PRIORS))
    # The light far away follows curvature and numerical aperture. A grid's neighbours differ by
    # half, and rings of a textured wall are right to some 3 %.
    assert cap_shape(guess)[0] == pytest.approx(cap_shape(drop)[0], rel=0.2)
    assert guess["numerical_aperture"] == pytest.approx(0.15, rel=0.2)


@pytest.mark.parametrize("sag", [0.0, 0.03, 0.25])
def test_a_caps_curvature_and_chord_are_regular_from_a_flat_end_to_a_half_ball(sag):
    cap = {"sag": sag, "aperture_radius": 0.25}
    curvature, chord = cap_shape(cap)
    # By Pythagoras, and by the sphere through apex and rim.
    assert chord == pytest.approx(math.hypot(sag, 0.25))
    assert sag == pytest.approx(curvature * (sag**2 + 0.25**2) / 2)
    assert cap_of(np.array([curvature, chord])) == pytest.approx(tuple(cap.values()))
    slopes, step = cap_slopes(cap), 1e-6
    ends = [[np.add((curvature, chord), sign * by) for by in step * np.eye(2)] for sign in (1, -1)]
    up, down = (np.array([cap_of(end) for end in part]) for part in ends)
    # Central differences are right to the square of the step over the chord's, 1e-11.
    np.testing.assert_allclose(slopes, (up - down).T / (2 * step), atol=1e-8)
    assert np.linalg.det(slopes) == pytest.approx(chord**3 / (2 * 0.25))


def test_several_recordings_of_a_lens_are_a_lens(stack):
    recording = recorded_trial(stack("lens", LENS))
    assert chosen_model([recording, recording])[0] == "lens"
