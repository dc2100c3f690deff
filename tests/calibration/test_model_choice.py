"""`eyespot fit` chooses the model, and a lens to start from, by what was measured alone."""

import json
import re
import shutil
import tomllib

import numpy as np
import pytest
import tomli_w

import optics
import scenes
from calibration.command.fitting import chosen_model
from calibration.command.lens_guess import guessed_lenses
from calibration.pixels.data import read_footage
from calibration.recordings import read_recording
from formats.stack import read_stack
from optics.wall_light.lens import lens_parameters

LENS = {"kind": "lens", "lens": "paper-candidate", "medium": "air"}
CONE = {"kind": "cone", "cone_k": 20.0, "cone_apex_offset_mm": -5.117}


@pytest.fixture(scope="module")
def stack(tmp_path_factory):
    folder = tmp_path_factory.mktemp("stacks")

    def render(name, source):
        if not (folder / name).exists():
            scene = scenes.Scene.model_validate(
                {
                    "schema": 1,
                    "source": source,
                    "motion": {"frames": 9},
                    "microscope": {"width_px": 320, "height_px": 240, "scale_mm_px": 0.0134},
                    "exposures": {"kinds": ["paper", "metered"]},
                }
            )
            scenes.render_stack(scene, folder / name)
        return folder / name

    return render


def falsified(stack, copy, source):
    """The stack with another source in its description, and labels that are all wrong."""
    shutil.copytree(stack, copy)
    description = tomllib.loads((copy / "stack.toml").read_text())
    description["scene"]["source"] |= source
    (copy / "stack.toml").write_text(tomli_w.dumps(description))
    lines = []
    for line in (copy / "metadata.jsonl").read_text().splitlines():
        labels = json.loads(line)
        for name, value in labels.items():
            if isinstance(value, float) and name not in ("time_s", "exposure_s"):
                labels[name] = 1.0
        lines.append(json.dumps(labels))
    (copy / "metadata.jsonl").write_text("\n".join(lines) + "\n")
    return copy


@pytest.mark.parametrize(
    ("source", "other", "model", "edges"),
    [(LENS, CONE, "lens", "soft"), (CONE, LENS, "cone", "sharp")],
)
def test_the_model_follows_the_spots_and_not_the_labels(
    stack, tmp_path, source, other, model, edges
):
    true = stack(model, source)
    for folder in (true, falsified(true, tmp_path / "false", {"kind": other["kind"]})):
        chosen, reason = chosen_model([read_recording(folder)])
        assert chosen == model
        assert edges in reason


def test_of_two_exposures_the_metered_one_is_measured(stack):
    folder = stack("cone", CONE)
    usual, metered = (read_recording(folder, exposure=e) for e in (None, "metered"))
    np.testing.assert_array_equal(
        usual.trial.ellipses.semi_minor, metered.trial.ellipses.semi_minor
    )


def test_a_lens_to_start_from_is_guessed_within_the_steps_of_the_grid(stack):
    kind = lens_parameters(optics.load_lens("dome"))  # another lens on the same fibre
    shown = stack("lens", LENS)
    guess = next(guessed_lenses(read_recording(shown), read_footage(read_stack(shown)), kind, {}))
    # The preset: a flat end, numerical aperture 0.10; neighbours on the grid are a third away.
    assert guess["numerical_aperture"] == pytest.approx(0.10, rel=0.3)
    assert guess["sag"] < 0.05


def test_several_recordings_of_a_lens_are_refused_with_a_remedy(stack):
    recording = read_recording(stack("lens", LENS))
    with pytest.raises(ValueError, match=re.compile("edges are soft.*give one stack", re.DOTALL)):
        chosen_model([recording, recording])
