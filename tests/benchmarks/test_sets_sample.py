"""The sample set in the package: small, complete, as its spec says, and scored in a minute."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import pytest

from benchmarks.sets.read import read_set, rows, verify_set
from benchmarks.sets.score.spots import NAME, sample_folder
from benchmarks.sets.spec import load_spec, plan
from tests.command_line import call


def test_the_sample_is_small_and_unchanged() -> None:
    folder = sample_folder()
    assert sum(path.stat().st_size for path in folder.rglob("*") if path.is_file()) <= 5e6
    assert verify_set(folder) > 80


def test_the_sample_is_what_its_spec_plans() -> None:
    labelled = read_set(sample_folder())
    planned = plan(load_spec(NAME))
    assert [(s.split, s.name) for s in labelled.stacks] == [(s.split, s.name) for s in planned]
    assert [s.parameters for s in labelled.stacks] == [s.parameters for s in planned]


def test_every_visible_image_of_the_sample_has_a_bound() -> None:
    for row in rows(read_set(sample_folder())):
        if row.labels.visible_fraction > 0.5:
            assert 0 < row.labels.bound_semi_minor_px < 0.05


def test_a_newcomer_scores_our_estimator_with_one_option(tmp_path: Path) -> None:
    done = call(["score", "--sample", "--out", str(tmp_path / "out")])
    assert done.exit_code == 0, done.output
    with (tmp_path / "out" / "leaderboard.csv").open(newline="") as file:
        first = next(csv.DictReader(file))
    assert first["entry"] == "auto"
    # No unbiased estimator is better than its bound; sub-pixel mode does not know the wall.
    assert float(first["over_bound"]) > 1
    assert json.loads((tmp_path / "out" / "score.json").read_text())["set"] == NAME


def test_a_newcomer_scores_a_file_of_his_own(tmp_path: Path) -> None:
    with (tmp_path / "mine.csv").open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["file_name", "x_px", "y_px", "semi_major_px", "semi_minor_px"])
        for row in rows(read_set(sample_folder())):
            labels, name = row.labels, f"{row.planned.split}/{row.line()['file_name']}"
            place = (labels.half_max_x_px, labels.half_max_y_px)
            axes = (labels.half_max_semi_major_px + 0.5, labels.half_max_semi_minor_px + 0.5)
            writer.writerow([name, *place, *axes])
    command = ["score", str(tmp_path / "mine.csv"), "--sample", "--out", str(tmp_path / "out")]
    done = call(command)
    assert done.exit_code == 0, done.output
    with (tmp_path / "out" / "leaderboard.csv").open(newline="") as file:
        first = next(csv.DictReader(file))
    assert (first["entry"], first["missed"]) == ("mine", "0.0")
    assert float(first["median"]) == pytest.approx(0.5)


def test_a_set_or_the_sample_must_be_named() -> None:
    done = call(["score"])
    assert "FOLDER is missing" in str(done.exception)
