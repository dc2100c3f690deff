"""The sample set in the package: small, complete, as its spec says, and scored in a minute."""

import json

import pandas as pd
import pytest

from benchmarks.sets.read import read_set, rows, stacks_of, verify_set
from benchmarks.sets.score.judging import images_of
from benchmarks.sets.score.spots import NAME, sample_folder
from benchmarks.sets.spec import load_spec, plan
from tests.command_line import call, printed


def test_the_sample_is_small_and_unchanged():
    folder = sample_folder()
    assert sum(path.stat().st_size for path in folder.rglob("*") if path.is_file()) <= 5e6
    assert verify_set(folder) > 80


def test_the_sample_is_what_its_spec_plans():
    labelled = read_set(sample_folder())
    planned = plan(load_spec(NAME))
    assert [(s.split, s.name) for s in labelled.stacks] == [(s.split, s.name) for s in planned]
    assert [s.parameters for s in labelled.stacks] == [s.parameters for s in planned]


def test_every_visible_image_of_the_sample_has_a_bound():
    for row in rows(read_set(sample_folder())):
        if row.labels.visible_fraction > 0.5:
            assert 0 < row.labels.bound_semi_minor_px < 0.05


@pytest.mark.parametrize("part", [("--split", "unseen"), pytest.param((), marks=pytest.mark.slow)])
def test_a_newcomer_scores_our_estimator_with_one_option(tmp_path, part):
    printed("score", "--sample", *part, "--out", tmp_path / "out")
    first = pd.read_csv(tmp_path / "out" / "leaderboard.csv").iloc[0]
    assert first.entry == "auto"
    # No unbiased estimator is better than its bound; sub-pixel mode does not know the wall.
    assert first.over_bound > 1
    assert json.loads((tmp_path / "out" / "score.json").read_text())["set"] == NAME


def test_a_newcomer_scores_a_file_of_his_own(tmp_path):
    images = images_of(stacks_of(sample_folder()))
    names = ("x_px", "y_px", "semi_major_px", "semi_minor_px")
    mine = pd.DataFrame({name: images[f"half_max_{name}"] for name in names})
    mine[["semi_major_px", "semi_minor_px"]] += 0.5
    mine.to_csv(tmp_path / "mine.csv", index_label="file_name")
    printed("score", tmp_path / "mine.csv", "--sample", "--out", tmp_path / "out")
    first = pd.read_csv(tmp_path / "out" / "leaderboard.csv").iloc[0]
    assert (first.entry, first.missed) == ("mine", 0.0)
    assert first["median"] == pytest.approx(0.5)


def test_a_set_or_the_sample_must_be_named():
    done = call(["score"])
    assert "FOLDER is missing" in str(done.exception)
