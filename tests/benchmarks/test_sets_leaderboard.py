"""Leaderboards: ranks follow from the errors, plain files suffice, intervals are over stacks."""

import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from eyespot.benchmarks.reporting import rows_of
from eyespot.benchmarks.sets.read import stacks_of
from eyespot.benchmarks.sets.score.judging import ALL, Outcome, images_of, standings, with_derived
from eyespot.benchmarks.sets.score.scored_spots import entries_in, read_any_spots
from eyespot.formats.inputs import InputError
from tests.support.command_line import call, printed
from tests.support.drawn.drawn_sets import image_row, labels_of

E1 = "semi_minor_px"


def judged(
    errors: Sequence[Sequence[float]], *, sigma: float = math.nan, medium: str = "air"
) -> pd.DataFrame:
    """Results on stacks with one list of errors each; infinite where the spot was missed."""
    images = []
    for stack, own in enumerate(errors):
        for frame, error in enumerate(own):
            labels = labels_of(0, frame=frame, file_name=f"{frame}.png", medium=medium)
            found = math.isfinite(error)
            result = {
                "outcome": Outcome.FOUND if found else Outcome.MISSED,
                f"error_{E1}": error if found else math.nan,
                f"sigma_{E1}": sigma if found else math.nan,
            }
            images.append(image_row(labels, stack=f"test/{stack:04d}") | result)
    return with_derived(pd.DataFrame(images))


def total(entries: dict[str, pd.DataFrame]) -> dict[str, Any]:
    """The entries' standings on all images."""
    found = standings(together(entries), E1)
    return {row.entry: row for row in rows_of(found[found.condition == ALL])}


def together(entries: dict[str, pd.DataFrame]) -> pd.DataFrame:
    return pd.concat(own.assign(estimator=name) for name, own in entries.items())


def test_an_entry_that_leaves_out_the_difficult_images_does_not_win():
    steady = [[0.2, -0.2, 0.2, -0.2]] * 6
    # Half as wrong where it answers, which it does on less than half of the images.
    choosy = [[0.1, math.inf, math.inf, math.inf], [0.1, -0.1, math.inf, math.inf]] * 3
    found = total({"choosy": judged(choosy), "steady": judged(steady)})
    assert found["steady"].rank == 1
    assert found["choosy"].rank == 2
    assert math.isinf(found["choosy"].median)
    assert found["choosy"].missed == pytest.approx(15 / 24)
    assert found["choosy"].rmse == pytest.approx(0.1)


def test_an_entry_that_finds_nothing_is_the_last():
    found = total({"blind": judged([[math.inf] * 3] * 4), "bad": judged([[9.0] * 3] * 4)})
    assert (found["bad"].rank, found["blind"].rank) == (1, 2)
    assert found["blind"].missed == 1.0
    assert standings(judged([[math.inf]]).assign(estimator="blind"), E1).empty


def test_an_interval_is_that_of_independent_stacks_and_not_of_images():
    # Each stack has one error in all of its 50 images, so there are 40 values and not 2000.
    rng = np.random.default_rng(1)
    values = rng.normal(0.0, 1.0, 40)
    found = total({"one": judged([[value] * 50 for value in values])})["one"]
    # The mean square of 40 normal values has the standard deviation sqrt(2/40), so the RMSE has
    # 1/sqrt(80) = 0.112 and an interval of 0.44. 40 values give that within a factor of 1.5; the
    # 2000 images would give 0.06.
    width = found.rmse_high - found.rmse_low
    assert 0.44 / 1.5 < width < 0.44 * 1.5


@pytest.mark.slow
def test_the_interval_of_a_median_covers_the_true_median():
    # Laplace distribution: the absolute error is exponential, with the median ln 2.
    rng = np.random.default_rng(2)
    tries = 60
    inside = 0
    for _ in range(tries):
        errors = rng.laplace(0.0, 1.0, (40, 1)).tolist()
        one = total({"one": judged(errors)})["one"]
        inside += one.median_low <= math.log(2) <= one.median_high
    # At least 99 % of binomial counts with p = 0.95 and n = 60 are from 52 to 60.
    assert inside >= 52


def test_entries_of_equal_quality_share_the_interval_of_their_ranks():
    rng = np.random.default_rng(3)
    entries = {
        name: judged(rng.normal(0.0, scale, (20, 5)).tolist())
        for name, scale in (("a", 0.1), ("b", 0.1), ("far", 1.0))
    }
    found = total(entries)
    assert {found["a"].rank, found["b"].rank} == {1, 2}
    for name in ("a", "b"):
        assert (found[name].rank_low, found[name].rank_high) == (1, 2)
    far = found["far"]
    assert (far.rank, far.rank_low, far.rank_high) == (3, 3, 3)


def test_coverage_is_that_of_the_errors():
    rng = np.random.default_rng(4)
    errors = rng.normal(0.0, 0.1, (100, 10)).tolist()
    honest = total({"one": judged(errors, sigma=0.1)})["one"]
    assert honest.within_1_low < 0.6827 < honest.within_1_high
    assert honest.within_196_low < 0.95 < honest.within_196_high
    proud = total({"one": judged(errors, sigma=0.05)})["one"]
    assert proud.within_1_high < 0.6827


def test_only_images_that_all_entries_cover_are_compared():
    everywhere, half = judged([[0.5] * 4, [0.1] * 4] * 2), judged([[0.5] * 4, [0.2] * 4] * 2)
    easy = half[half["stack"].str.endswith(("1", "3"))]
    found = total({"everywhere": everywhere, "easy": easy})
    assert found["everywhere"].visible == found["easy"].visible == 8
    assert found["everywhere"].median == pytest.approx(0.1)
    other = easy.assign(stack="elsewhere")
    with pytest.raises(InputError, match="no image together"):
        standings(together({"everywhere": everywhere, "other": other}), E1)


def test_an_efficient_estimator_is_at_the_bound_and_a_miss_is_beyond_it():
    rng = np.random.default_rng(6)
    # Each image has its own bound, and normal errors of that size.
    bounds = rng.uniform(0.01, 0.1, (50, 20))
    errors = rng.normal(0.0, bounds)

    def images(errors: np.ndarray) -> pd.DataFrame:
        return judged(errors.tolist()).assign(bound_semi_minor_px=bounds.ravel())

    found = total({"efficient": images(errors), "double": images(2 * errors)})
    # The median of 1000 values |e|/sigma scatters by 1/(2 sqrt(1000) 2 phi(0.67)) = 2.5 %, divided
    # by 0.67: 3.7 %; 3 of these.
    assert found["efficient"].over_bound == pytest.approx(1.0, abs=0.11)
    assert found["double"].over_bound == pytest.approx(2.0, abs=0.22)
    errors[rng.random(errors.shape) < 0.6] = math.inf
    assert math.isinf(total({"choosy": images(errors)})["choosy"].over_bound)


def plain(path: Path, drawn: Path, *, off: float, columns: str = "ellipse") -> Path:
    """The labels, off by some px, as somebody without eyespot writes them."""
    path.parent.mkdir(parents=True, exist_ok=True)
    images = images_of(stacks_of(drawn))
    if columns == "distance":
        table = pd.DataFrame({"distance_mm": images.d_mm + off, "sigma_distance_mm": 0.1})
    else:
        names = ("x_px", "y_px", "semi_major_px", "semi_minor_px")
        table = pd.DataFrame({name: images[f"half_max_{name}"] for name in names})
        table[["semi_major_px", "semi_minor_px"]] += off
        table["sigma_semi_minor_px"] = 0.1
    table.to_csv(path, index_label="file_name")
    return path


def test_a_plain_csv_and_a_description_are_an_entry(drawn, tmp_path):
    entries = tmp_path / "entries"
    plain(entries / "theirs.csv", drawn, off=0.3)
    plain(entries / "network" / "all.csv", drawn, off=0.1)
    plain(entries / "regression.csv", drawn, off=0.05, columns="distance")
    about = {"name": "a network", "command": "predict.py", "versions": {"torch": "2"}, "seed": 7}
    (entries / "network" / "entry.json").write_text(json.dumps(about | {"ms_per_frame": 4.5}))
    out = tmp_path / "out"
    printed("score", drawn, "--entries", entries, "--out", out)
    rows = pd.read_csv(out / "leaderboard.csv")
    ranked = rows[rows.quantity == E1]
    assert [*zip(ranked.entry, ranked["rank"], strict=True)] == [("a network", 1), ("theirs", 2)]
    first = rows.iloc[0]
    assert (first.command, first.versions, first.seed) == ("predict.py", "torch 2", 7)
    assert (first.ms_per_frame, first["median"]) == (4.5, pytest.approx(0.1))
    (distance,) = rows_of(rows[rows.quantity == "distance_mm"])
    assert (distance.entry, distance.median) == ("regression", pytest.approx(0.05))
    page = (out / "report.html").read_text()
    assert "a network" in page and "predict.py" in page


def test_one_split_is_scored_alone(drawn, tmp_path):
    plain(tmp_path / "theirs.csv", drawn, off=0.3)
    command = ["score", str(drawn), str(tmp_path / "theirs.csv"), "--split", "adverse"]
    printed(*command, "--out", tmp_path / "out")
    found = json.loads((tmp_path / "out" / "score.json").read_text())
    outcomes = found["outcomes"]["theirs"]
    assert sum(outcomes.values()) == 4  # images of the split adverse
    done = call([*command[:-1], "tset"])
    assert "no split tset. It has: adverse, train" in str(done.exception)


HEADER = "file_name,x_px,y_px,semi_major_px,semi_minor_px"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("name,x_px\n", "unknown column 'name'; did you mean file_name?"),
        ("file_name,x_px,y_px\n", "column semi_major_px is missing"),
        ("x_px,y_px,semi_major_px,semi_minor_px\n", "column file_name is missing"),
        (f"{HEADER}\na.png,1,2,3,\n", "line 2.*semi_minor_px is empty"),
        (f"{HEADER}\na.png,1,2,3,4\n", "at least semi_minor_px; got 3.0 and 4.0 px. Swap"),
        (f"{HEADER}\na.png,1,2,-3,-4\n", "semi_major_px must be above 0; got -3"),
        (f"{HEADER}\na.png,one,2,3,4\n", "x_px must be a finite number; got 'one'"),
        (f"{HEADER},sigma_x_px\na.png,1,2,4,3,-1\n", "sigma_x_px must be at least 0; got -1"),
        (f"{HEADER}\n,1,2,4,3\n", "file_name must not be empty"),
        (f"{HEADER},angle_rad\na.png,1,2,4,3,37\n", "angle_rad .* radians, not degrees"),
    ],
)
def test_what_is_wrong_in_a_plain_file_is_named(text, words, tmp_path):
    path = tmp_path / "theirs.csv"
    path.write_text(text)
    with pytest.raises(InputError, match=words):
        read_any_spots(path)


def test_empty_cells_are_an_image_without_a_spot(tmp_path):
    path = tmp_path / "theirs.csv"
    path.write_text(f"{HEADER}\na.png,1,2,4,3\nb.png,,,,\n")
    first, second = read_any_spots(path)
    assert first.status == "spot" and second.status == "no_spot"


def test_a_folder_without_entries_is_refused(tmp_path):
    with pytest.raises(InputError, match="has no entries"):
        entries_in(tmp_path)
    with pytest.raises(InputError, match="no such folder"):
        entries_in(tmp_path / "missing")
    (tmp_path / "one").mkdir()
    (tmp_path / "one" / "entry.json").write_text('{"ms_per_frame": -1}')
    with pytest.raises(InputError, match=r"entry.json.*ms_per_frame"):
        entries_in(tmp_path)
