"""The sample set in the package: complete, scored in a minute, loaded as the page of sets says."""

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from eyespot.benchmarks.sets.read import read_set, rows, stacks_of, verify_set
from eyespot.benchmarks.sets.score.judging import images_of
from eyespot.benchmarks.sets.score.scored_spots import NAME, sample_folder
from eyespot.benchmarks.sets.spec import load_spec, plan
from tests.support.command_line import call, printed

PAGE = Path(__file__).resolve().parents[2] / "docs" / "datasets.md"


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
    text = (tmp_path / "out" / "report.html").read_text()
    assert "mine has a median error of 0.500 px" in text
    # An entry alone is compared with nobody.
    assert "least median error" not in text
    assert "How the entries were made" not in text


def test_a_set_or_the_sample_must_be_named():
    done = call(["score"])
    assert "FOLDER is missing" in str(done.exception)


def test_the_loader_returns_images_ellipses_and_distances_of_a_split():
    """A map-style dataset of PyTorch is any object with these two methods; torch is not here."""
    blocks = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    (code,) = (block for block in blocks if "class Spots" in block)
    found: dict[str, Any] = {}
    exec(code, found)
    dataset = found["Spots"](sample_folder(), "test")
    truth = [row for row in rows(read_set(sample_folder())) if row.planned.split == "test"]
    assert len(dataset) == len(truth) == 30
    for index in (0, 7, 29):
        image, ellipse, distance = dataset[index]
        labels, shown = truth[index].labels, truth[index].stack.image(truth[index].labels)
        np.testing.assert_allclose(image.transpose(1, 2, 0) * 255, shown, atol=1e-4)
        # Single precision of numbers up to 320 px.
        place = (labels.half_max_x_px, labels.half_max_y_px)
        np.testing.assert_allclose(ellipse[:2], place, rtol=1e-6)
        np.testing.assert_allclose(ellipse[3], labels.half_max_semi_minor_px, rtol=1e-6)
        np.testing.assert_allclose(distance, labels.d_mm, rtol=1e-6)
        assert image.dtype == ellipse.dtype == np.float32
