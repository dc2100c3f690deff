"""Values that have the wrong type, or that nothing in the world can have, are refused by name."""

import json
import math
import shutil
from pathlib import Path

import numpy as np
import pytest

from eyespot.benchmarks.sets.read import check_unchanged, stacks_of
from eyespot.benchmarks.sets.score.scored_spots import entry_of, read_any_spots, sample_folder
from eyespot.formats.inputs import InputError
from eyespot.formats.spot import Spot
from eyespot.formats.spots import read_spots
from eyespot.formats.stack import read_stack
from eyespot.scenes.description.scene_file import load_scene
from tests.support.files.bad_input import OLD


@pytest.fixture
def stack(tmp_path):
    return Path(shutil.copytree(OLD / "small-v1" / "train" / "0000", tmp_path / "stack"))


def relabelled(stack: Path, **labels: object) -> Path:
    """The stack with other labels of its first image."""
    first, *rest = (stack / "metadata.jsonl").read_text().splitlines()
    lines = [json.dumps(json.loads(first) | labels), *rest]
    (stack / "metadata.jsonl").write_text("\n".join(lines) + "\n")
    return stack


@pytest.mark.parametrize(
    ("labels", "rule"),
    [
        ({"d_mm": -3.0}, "d_mm must lie from 0"),
        ({"half_max_semi_minor_px": -3.0}, "half_max_semi_minor_px must lie from"),
        ({"half_max_semi_minor_px": 1e6}, "half_max_semi_minor_px must lie from"),
        ({"half_max_semi_minor_px": 50.0}, "must not exceed half_max_semi_major_px"),
        ({"axis": [5.0, 5.0, 5.0]}, "axis must be a unit vector"),
        ({"axis": [math.nan, 0.5, -0.866]}, "axis must be a unit vector"),
        ({"visible_fraction": 7.0}, "visible_fraction must lie from 0 to 1"),
        ({"exposure_s": -1.0}, "exposure_s must lie from 0"),
        ({"incidence_rad": 2.0}, "incidence_rad must lie from 0"),
        ({"cone_angle_rad": 4.71}, "cone_angle_rad must lie from"),
        ({"nearest_mm": 2.5}, "nearest_mm must not exceed d_mm"),
        ({"frame": 1}, "frame 1 has another line with exposure 'metered'"),
        ({"mask_file_name": "frames/000000.png"}, "is a frame, not a mask"),
    ],
    ids=str,
)
def test_labels_of_no_image_are_refused(stack, labels, rule):
    with pytest.raises(InputError, match=rule):
        read_stack(relabelled(stack, **labels))


def test_labels_that_are_not_known_are_accepted(stack):
    labels = read_stack(relabelled(stack, d_mm=math.nan, nearest_mm=math.nan)).labels
    assert math.isnan(labels[0].d_mm)


@pytest.mark.parametrize("name", ["stack.toml", "metadata.jsonl", "microscope.json"])
def test_a_stack_whose_description_is_a_link_out_of_it_is_refused(stack, tmp_path, name):
    (stack / name).rename(tmp_path / name)
    (stack / name).symlink_to(tmp_path / name)
    with pytest.raises(InputError, match="a link that leads out of"):
        read_stack(stack)


def respotted(tmp_path: Path, **cells: str) -> Path:
    """The old spots file with other cells in its first row."""
    header, first, *rest = (OLD / "spots.csv").read_text().splitlines()
    row = dict(zip(header.split(","), first.split(","), strict=True)) | cells
    path = tmp_path / "spots.csv"
    path.write_text("\n".join([header, ",".join(row.values()), *rest]) + "\n")
    return path


@pytest.mark.parametrize(
    ("cells", "rule"),
    [
        ({"semi_minor_px": "500"}, "semi_minor_px must not exceed semi_major_px"),
        ({"cov_x_y": "9"}, "no correlation may exceed 1"),
        (
            {"cov_semi_minor_semi_minor": "0", "cov_x_semi_minor": "1e-9"},
            "no correlation may exceed",
        ),
        ({"x_px": "1_0"}, "x_px must be a finite number; got '1_0'"),
        ({"x_px": "\u0663\u0662\u0660"}, "x_px must be a finite number"),
        ({"angle_rad": "90"}, "Write radians, not degrees"),
    ],
    ids=str,
)
def test_spots_of_no_image_are_refused(tmp_path, cells, rule):
    with pytest.raises(InputError, match=rule):
        read_spots(respotted(tmp_path, **cells))


@pytest.mark.parametrize("turn", [0.3 - math.pi, 0.3, 0.3 + math.pi])
def test_an_angle_counts_modulo_half_a_turn_in_spots_of_others(tmp_path, turn):
    file = tmp_path / "mine.csv"
    file.write_text(
        "file_name,x_px,y_px,semi_major_px,semi_minor_px,angle_rad\n"
        f"frames/000000.png,9,9,5,4,{turn!r}\n"
    )
    (record,) = read_any_spots(file)
    assert isinstance(record.result, Spot)
    assert record.result.angle_rad == pytest.approx(0.3)


def test_a_set_is_scored_only_as_its_manifest_lists_it(tmp_path):
    folder = Path(shutil.copytree(sample_folder(), tmp_path / "sample"))
    (folder / "mine.csv").write_text("what a user keeps there")
    check_unchanged(stacks_of(folder))
    relabelled(folder / "test" / "0000", d_mm=2.5, nearest_mm=2.0)
    with pytest.raises(InputError, match=r"test/0000/metadata\.jsonl differs from its checksum"):
        check_unchanged(stacks_of(folder))


@pytest.mark.parametrize("name", ["=cmd|calc!A0.csv", "+1.csv", "@sum.csv"])
def test_an_entry_whose_name_a_spreadsheet_would_run_is_refused(tmp_path, name):
    with pytest.raises(InputError, match="must begin with a letter or a digit"):
        entry_of(tmp_path / name)


def test_numpy_numbers_are_numbers_of_a_scene():
    changed = load_scene(None).model_copy()
    spot = {"eccentricity_mm": np.float64(1.5)}
    assert type(changed).model_validate({"spot": spot}).spot.eccentricity_mm == 1.5
