"""Files as eyespot 0.1.0 wrote them are read for ever, and newer ones are refused by name."""

import json
import math
import re
import shutil
from pathlib import Path

import numpy as np
import pytest

from eyespot.benchmarks.sets.read import read_set, verify_set
from eyespot.benchmarks.sets.spec import load_spec
from eyespot.formats.calibration import read_calibration
from eyespot.formats.inputs import InputError
from eyespot.formats.microscope import read_microscope
from eyespot.formats.poses import read_poses
from eyespot.formats.spot import NoSpot, Reason, Spot
from eyespot.formats.spots import read_spots
from eyespot.formats.stack import read_stack
from eyespot.scenes.description.scene import Scene
from eyespot.scenes.description.scene_file import load_scene

OLD = Path(__file__).parents[1] / "files-0.1"
STACK = OLD / "small-v1" / "train" / "0000"


def test_a_stack_of_0_1_is_read():
    stack = read_stack(STACK)
    stack.verify()
    first, second = stack.labels
    assert first.file_name == "frames/000000.png"
    assert (first.d_mm, second.d_mm) == (2.0, 3.000000000000001)
    assert first.c_mm == 0.3396160388365388
    assert first.half_max_semi_minor_px == 6.589644661266726
    assert first.seed == 3145728
    assert stack.image(first).shape == (60, 80, 3)
    # The mask is the inside of the half-maximum contour, to the pixels of its edge.
    area = math.pi * first.half_max_semi_major_px * first.half_max_semi_minor_px
    edge = 2 * math.pi * first.half_max_semi_major_px
    assert np.count_nonzero(stack.mask(first)) == pytest.approx(area, abs=edge)
    assert stack.described("scene.source.cone_k", float) == 20.0
    microscope = read_microscope(STACK / "microscope.json")
    assert (microscope.width_px, microscope.height_px, microscope.scale_mm_px) == (80, 60, 0.054)
    assert microscope.pinhole_height_mm == microscope.eye_radius_mm == 11.5
    poses = list(read_poses(STACK / "kinematics.csv"))
    assert poses[1].time_s - poses[0].time_s == pytest.approx(0.2, abs=1e-6)  # 5 Hz
    # The poses' axis is written to a nanoradian, their tip to a nanometre.
    np.testing.assert_allclose(poses[1].axis, first.axis, atol=1e-8)
    np.testing.assert_allclose(poses[0].position_mm, first.tip_mm, atol=1e-5)


def test_a_set_of_0_1_is_read():
    labelled = read_set(OLD / "small-v1")
    assert labelled.name == "small-v1"
    assert [(stack.split, stack.name, stack.condition) for stack in labelled.stacks] == [
        ("train", "0000", None),
        ("adverse", "dim-0000", "dim"),
    ]
    assert labelled.stacks[1].parameters["camera.full_well_e"] == 500.0
    # Its two pictures, 200 kB, are not kept here; all else is as the manifest says.
    with pytest.raises(InputError) as caught:
        verify_set(OLD / "small-v1")
    assert re.findall(r"(\w+\.png) is missing", str(caught.value)) == [
        "histograms.png",
        "samples.png",
    ]
    assert len(str(caught.value).splitlines()) == 2


def test_spots_of_version_1_may_say_that_a_frame_met_a_bug(tmp_path):
    text = (OLD / "spots.csv").read_text()
    assert "occluded" in text
    (tmp_path / "spots.csv").write_text(text.replace("occluded", "internal_error"))
    reasons = [record.reason for record in read_spots(tmp_path / "spots.csv")]
    assert Reason.INTERNAL_ERROR.value in reasons


@pytest.mark.parametrize("name", ["spots.csv", "spots.parquet"])
def test_spots_of_0_1_are_read(name):
    first, second, third = read_spots(OLD / name)
    assert isinstance(first.result, Spot)
    assert (first.result.x_px, first.result.semi_minor_px) == (320.5, 60.0)
    assert first.result.covariance[1, 0] == 2e-5
    assert (first.distance_mm, first.sigma_distance_mm, first.pose_age_s) == (2.5, 0.01, 0.004)
    assert second.result == NoSpot(Reason.OCCLUDED)
    assert isinstance(third.result, Spot)
    assert third.mode == "literal"
    assert math.isnan(third.time_s)
    assert math.isnan(third.result.coverage)


def test_calibrations_of_0_1_are_read():
    planar = read_calibration(OLD / "calibration.json")
    assert dict(planar.values) == {"k": 20.0, "b": -5.117, "scale": 0.0067}
    assert planar.sigma("k") == 0.1
    assert planar.sigma_inflation == 1.0
    lens = read_calibration(OLD / "calibration-lens.json")
    assert (lens.model, *dict(lens.medium).values()) == ("lens", "vitreous", 1.336)
    assert lens.values["sag"] == 0.12


def test_a_scene_and_a_spec_of_0_1_are_read():
    scene = load_scene(OLD / "scene.toml")
    assert scene == Scene.model_validate({"schema": 1})
    assert scene.source == Scene().source
    spec = load_spec(OLD / "spec.toml")
    assert (spec.name, spec.splits.train) == ("small-v1", 1)


def _newer(path: Path) -> None:
    text = path.read_text()
    if path.suffix == ".csv":
        path.write_text(re.sub(",1$", ",99", text, flags=re.MULTILINE))
    elif path.suffix == ".toml":
        path.write_text(re.sub("^schema = 1$", "schema = 99", text, flags=re.MULTILINE))
    else:
        path.write_text(json.dumps(json.loads(text) | {"schema": 99, "more": "fields"}))


@pytest.mark.parametrize(
    ("name", "read"),
    [
        ("calibration.json", read_calibration),
        ("spots.csv", read_spots),
        ("small-v1/train/0000/microscope.json", read_microscope),
        ("small-v1/train/0000/stack.toml", lambda path: read_stack(path.parent)),
        ("small-v1/train/0000/manifest.json", lambda path: read_stack(path.parent).verify()),
        ("small-v1/set.json", lambda path: read_set(path.parent)),
        ("small-v1/manifest.json", lambda path: verify_set(path.parent)),
        ("scene.toml", load_scene),
        ("spec.toml", load_spec),
    ],
)
def test_a_newer_file_is_refused_with_the_way_out(tmp_path, name, read):
    shutil.copytree(OLD, tmp_path, dirs_exist_ok=True)
    _newer(tmp_path / name)
    newer = (
        r"schema is 99; this eyespot \(\d+\.\d+\.\d+\) reads 1( to \d)?\. Install a newer eyespot\."
    )
    with pytest.raises(InputError, match=f"{Path(name).name}.*{newer}"):
        read(tmp_path / name)
