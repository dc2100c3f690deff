"""`eyespot score`: errors that were put in come out; misses and false spots are counted."""

import io
import json
import math
import shutil
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any
from xml.etree import ElementTree

import matplotlib
import numpy as np
import pandas as pd
import pytest

from eyespot.benchmarks.reporting import Picture, rows_of, where
from eyespot.benchmarks.sets.read import stacks_of
from eyespot.benchmarks.sets.score import scored_spots as spots_of_set
from eyespot.benchmarks.sets.score.judging import Score, images_of, score, with_derived
from eyespot.benchmarks.sets.score.leaderboard_page import leaderboard
from eyespot.benchmarks.sets.score.score_command import tables
from eyespot.benchmarks.sets.score.scored_spots import ScoredEstimator, read_set_spots
from eyespot.estimator import Source, track_whole_source
from eyespot.formats.spot import NoSpot, Reason, Spot
from eyespot.formats.spots import SpotRecord, write_spots
from tests.support.command_line import call, printed
from tests.support.drawn.drawn_sets import MICROSCOPE, STACKS, image_row, labels_of
from tests.support.drawn.made_up import a_spot

SVG = "{http://www.w3.org/2000/svg}"


@pytest.fixture(scope="module")
def images(drawn):
    return images_of(stacks_of(drawn))


def in_memory(count: int, stacks: int = 1, **known: Any) -> pd.DataFrame:
    """Images of a set that lies on no disk."""
    rows = {
        f"test/{n % stacks:04d}/frames/{n:06d}.png": image_row(
            labels_of(0, frame=n, **known), stack=f"test/{n % stacks:04d}"
        )
        for n in range(count)
    }
    return with_derived(pd.DataFrame.from_dict(rows, orient="index"))


def spot_at(labels: Any, *, sigma: float = math.nan, **error: float) -> Spot:
    """The half-maximum ellipse of the labels, off by errors in px."""
    names = ("x_px", "y_px", "semi_major_px", "semi_minor_px", "angle_rad")
    ellipse = (getattr(labels, f"half_max_{name}") + error.get(name, 0.0) for name in names)
    return a_spot(*ellipse, covariance=np.eye(5) * sigma**2)


def records_of(
    images: pd.DataFrame, result: Callable[[Any], Spot | NoSpot], *, late_mm: float = math.nan
) -> dict[str, SpotRecord]:
    return {
        row.image: SpotRecord(
            frame=row.frame,
            file_name=row.image,
            time_s=row.time_s,
            mode="subpixel",
            result=result(row),
            distance_mm=row.d_mm + late_mm,
        )
        for row in rows_of(images.reset_index(names="image"))
    }


def scored(images: pd.DataFrame, records: Mapping[str, SpotRecord], **options: str) -> Score:
    return score(images, {"theirs": records}, **{"against": "half_max", **options})  # type: ignore[arg-type]


def errors_in(result: Score, quantity: str) -> Any:
    """Errors over all images."""
    errors = result.errors
    (found,) = rows_of(errors[(errors.condition == "all") & (errors.quantity == quantity)])
    return found


def counts_in(result: Score) -> Any:
    """Counts of all images."""
    return rows_of(result.counts[result.counts.condition == "all"])[0]


def test_an_offset_is_the_bias_of_its_quantity_alone(images):
    offsets = {"x_px": 0.5, "y_px": -0.25, "semi_major_px": 1.5, "semi_minor_px": -2.0}
    result = scored(images, records_of(images, lambda row: spot_at(row, **offsets), late_mm=0.125))
    # Sums and differences of numbers below 100 in float64.
    rounding = 1e-12
    for quantity, offset in {**offsets, "distance_mm": 0.125}.items():
        errors = errors_in(result, quantity)
        assert errors.bias == pytest.approx(offset, abs=rounding)
        for size in (errors.rmse, errors.median_abs, errors.max_abs):
            assert size == pytest.approx(abs(offset), abs=rounding)
    assert errors_in(result, "centre_px").rmse == pytest.approx(math.hypot(0.5, 0.25), abs=rounding)
    assert math.isnan(errors_in(result, "centre_px").bias)


def test_perfect_spots_have_no_error_and_miss_nothing(images):
    visible = images[images.visible_fraction > 0]
    result = scored(images, records_of(visible, spot_at))
    counts = counts_in(result)
    assert (counts.found, counts.missed, counts.false_spots) == (len(visible), 0, 0)
    assert counts.hidden == len(images) - len(visible) == 1
    of_all = result.errors[result.errors.condition == "all"]
    names = ("x_px", "y_px", "centre_px", "semi_major_px", "semi_minor_px", "angle_rad")
    assert of_all.set_index("quantity").max_abs.to_dict() == dict.fromkeys(names, 0.0)


def test_the_angle_is_scored_where_the_ellipse_is_not_round(images):
    # The axis at 0.3 rad, turned by 2.9 rad: a half turn less is the same axis.
    turned = scored(images, records_of(images, lambda row: spot_at(row, angle_rad=2.9)))
    assert errors_in(turned, "angle_rad").bias == pytest.approx(2.9 - math.pi, abs=1e-12)
    in_degrees = math.degrees(0.3) - 0.3
    wrong = scored(images, records_of(images, lambda row: spot_at(row, angle_rad=in_degrees)))
    assert errors_in(wrong, "angle_rad").rmse > 1.0
    round_ = images.assign(half_max_semi_minor_px=images.half_max_semi_major_px - 0.5)
    found = scored(round_, records_of(round_, spot_at)).errors
    assert "angle_rad" not in {*found.quantity}


def test_the_other_ellipse_is_another_truth(images):
    # The drawn labels' cone has an edge 1 px outside the half-maximum contour.
    result = scored(images, records_of(images, spot_at), against="cone")
    assert errors_in(result, "semi_minor_px").bias == pytest.approx(-1.0, abs=1e-12)


def test_what_was_missed_or_invented_is_counted():
    seen, barely, unseen = (
        in_memory(count, visible_fraction=part) for count, part in ((10, 0.5), (7, 0.49), (5, 0.0))
    )
    images = pd.concat(
        group.rename(index=f"{kind} {{}}".format)
        for kind, group in (("seen", seen), ("barely", barely), ("unseen", unseen))
    )
    labels = labels_of(0)
    inside, outside = (labels.half_max_semi_major_px + step for step in (-0.01, 0.01))
    records = records_of(images, lambda row: NoSpot(Reason.NONE_FOUND))
    names = {kind: [n for n in images.index if n.startswith(kind)] for kind in ("seen", "barely")}
    for name, far in zip(names["seen"], (0, 0, inside, outside, outside), strict=False):
        records[name] = replace(records[name], result=spot_at(labels, x_px=far))
    for name, far in zip(names["barely"], (0, 0, 0, outside), strict=False):
        records[name] = replace(records[name], result=spot_at(labels, y_px=far))
    hidden = next(name for name in images.index if name.startswith("unseen"))
    records[hidden] = replace(records[hidden], result=spot_at(labels))

    counts = counts_in(scored(images, records))
    assert (counts.images, counts.visible, counts.hidden) == (22, 10, 12)
    assert (counts.found, counts.missed) == (3, 7)  # two of the seven are elsewhere
    assert counts.false_spots == 2 + 1 + 1  # elsewhere of seen, elsewhere of barely, of nothing
    assert counts.glimpsed == 3
    assert errors_in(scored(images, records), "x_px").n == 3


def test_an_image_without_a_line_is_missed_unless_its_whole_kind_is_left_out(images):
    records = records_of(images, spot_at)
    metered = images[(images.split == "train") & (images.exposure == "metered")].index
    told = {name: records[name] for name in metered.drop("train/a/frames/000002.png")}
    result = scored(images, told)
    counts = counts_in(result)
    assert (counts.images, counts.missed) == (8, 1)
    assert result.left_out["theirs"] == len(images) - 8


@pytest.mark.parametrize(("claimed", "honest"), [(1.0, True), (0.5, False), (2.0, False)])
def test_sigma_is_honest_where_errors_scatter_as_it_says(claimed, honest):
    images = in_memory(1000, stacks=100)
    rng = np.random.default_rng(3)
    result = scored(
        images,
        records_of(
            images, lambda row: spot_at(row, sigma=0.1 * claimed, semi_minor_px=rng.normal(0, 0.1))
        ),
    )
    errors = errors_in(result, "semi_minor_px")
    inside_1 = errors.within_1_low < math.erf(1 / math.sqrt(2)) < errors.within_1_high
    inside_2 = errors.within_2_low < math.erf(2 / math.sqrt(2)) < errors.within_2_high
    assert (inside_1 and inside_2) == honest
    # Of 1000 normal values the standard deviation scatters by 1/sqrt(2 * 1000) = 2.2 %; 4 sigma.
    assert errors.z_std * claimed == pytest.approx(1.0, rel=0.09)
    # No errors were put in: with a sigma, but not of this size.
    assert errors_in(result, "x_px").within_1_sigma == 1.0


def test_stacks_that_differ_widen_the_interval_of_rmse():
    alike, apart = in_memory(60, stacks=12), in_memory(60, stacks=12)
    same = scored(alike, records_of(alike, lambda row: spot_at(row, x_px=0.1)))
    assert errors_in(same, "x_px").rmse_low == pytest.approx(0.1, abs=1e-12)
    assert errors_in(same, "x_px").rmse_high == pytest.approx(0.1, abs=1e-12)
    # Half of the stacks are off by 0.1 and half by 0.3: mean square 0.05 +- 0.04/sqrt(12), which
    # two standard deviations of 0.0115 take to [0.027, 0.073].
    off = (0.1, 0.3)
    mixed = scored(apart, records_of(apart, lambda row: spot_at(row, x_px=off[row.frame % 2])))
    errors = errors_in(mixed, "x_px")
    assert errors.rmse == pytest.approx(math.sqrt(0.05))
    assert errors.rmse_low == pytest.approx(math.sqrt(0.027), rel=0.1)
    assert errors.rmse_high == pytest.approx(math.sqrt(0.073), rel=0.1)


def test_images_are_scored_apart_by_condition(images):
    result = scored(
        images, records_of(images, lambda row: spot_at(row, semi_minor_px=0.1 * row.frame))
    )
    rows = result.by_condition.set_index(["condition", "group"])
    bias = rows.bias
    # d = 1, 2, 3 and 4 mm for frames 0 to 3.
    assert bias["d_mm", "1–2"] == pytest.approx(0.0, abs=1e-12)
    assert bias["d_mm", "2–4"] == pytest.approx(1.1 / 7, abs=1e-12)  # a 0.1 is hidden
    assert bias["d_mm", "4–6"] == pytest.approx(0.3, abs=1e-12)
    assert rows.images["split", "adverse"] == 4
    assert "medium" not in set(result.by_condition.condition)  # all in air


def test_names_with_markup_are_shown_as_they_are():
    name, medium, exposure = "_a$b$[b]c_", "_d$e$[i]f_", "[/b]g$h$"
    other = in_memory(4, medium=medium, exposure=exposure).rename(index="other/{}".format)
    images = pd.concat([in_memory(4, medium="air"), other])
    records = records_of(images, lambda row: spot_at(row, semi_minor_px=0.1))
    result = score(images, {name: records}, against="half_max")
    printed = "".join(table.to_string() for table in tables(result).values())
    assert all(text in printed for text in (name, medium, exposure))
    picture, *_ = leaderboard(result, [ScoredEstimator(name=name)], name="set").first
    assert isinstance(picture, Picture)
    figure = io.BytesIO()
    with matplotlib.rc_context({"svg.fonttype": "none"}):  # text as text, not as outlines
        picture.figure.savefig(figure, format="svg")
    root = ElementTree.fromstring(figure.getvalue())
    assert name in {"".join(text.itertext()).strip() for text in root.iter(f"{SVG}text")}


def test_why_spots_were_missed_is_shown_and_a_table_without_rows_is_not():
    images = in_memory(4)
    no_spot = NoSpot(Reason.AMBIGUOUS)
    records = {
        name: SpotRecord(frame=0, file_name=str(name), time_s=0.0, mode="", result=no_spot)
        for name in images.index
    }
    shown = tables(score(images, {"theirs": records}, against="half_max"))
    assert shown["Images"].why_missed.tolist() == [f"{len(images)} ambiguous"]
    assert not any("σ" in title for title in shown)


def test_images_that_are_no_sequence_are_measured_each_by_itself(drawn, tmp_path, monkeypatch):
    folder = shutil.copytree(drawn / "train" / "a", tmp_path / "a")
    followed = []

    def spied(source: Source, reader: object, **given: object) -> list[SpotRecord]:
        followed.append(not source.unrelated)
        return track_whole_source(source, reader, **given)  # type: ignore[arg-type]

    monkeypatch.setattr(spots_of_set, "track_whole_source", spied)

    def follows(words: list[str]) -> set[bool]:
        followed.clear()
        printed("score", folder, "--mode", "subpixel", *words)
        return set(followed)

    assert follows([]) == {True}
    assert follows(["--unrelated"]) == {False}
    # 100 px from one image to the next are more than the 80 px over which a spot is followed.
    (folder / "manifest.json").unlink()  # as of a set that others made
    file = folder / "metadata.jsonl"
    rows = [json.loads(line) for line in file.read_text().splitlines()]
    rows = [row | {"half_max_x_px": 100.0 * row["frame"]} for row in rows]
    file.write_text("".join(json.dumps(row) + "\n" for row in rows))
    assert follows([]) == {False}
    assert follows(["--sequence"]) == {True}


def test_our_estimator_is_scored_from_its_files_as_when_it_is_run(drawn, tmp_path):
    tracked = tmp_path / "tracked"  # spots as `eyespot track` writes them, stack by stack
    for split, name in ((split, name) for split, names in STACKS.items() for name in names):
        (tracked / split).mkdir(parents=True, exist_ok=True)
        for exposure in ("paper", "metered") if name == "b" else ("",):
            out = tracked / split / (f"{name}.{exposure}.csv" if exposure else f"{name}.csv")
            chosen = ["--exposure", exposure] if exposure else []
            printed("track", drawn / split / name, "--out", out, *chosen)
    printed("score", drawn, tracked, "--mode", "subpixel", "--out", tmp_path / "score")
    rows = pd.read_csv(tmp_path / "score" / "score.csv")
    read, run = (
        where(rows, estimator=name).drop(columns="estimator").reset_index(drop=True)
        for name in ("tracked", "subpixel")
    )
    pd.testing.assert_frame_equal(read, run, check_exact=True)
    (total,) = rows_of(where(run, condition="all", quantity="semi_minor_px"))
    # Drawn spots of a clean edge: the estimator's own tests hold 0.05 px.
    assert total.rmse < 0.05
    assert total.missed == 0
    found = json.loads((tmp_path / "score" / "score.json").read_text())
    assert found["outcomes"]["subpixel"] == {"found": 15, "hidden": 1}
    for name in ("report.html", "leaderboard.csv", "figures/standings_semi_minor_px.svg"):
        assert (tmp_path / "score" / name).stat().st_size > 0


def test_a_stack_by_itself_is_scored_with_the_names_that_track_writes(drawn, tmp_path):
    stack = drawn / "train" / "a"
    images = images_of(stacks_of(stack))
    write_spots(tmp_path / "theirs.csv", records_of(images, spot_at).values())
    records = read_set_spots(tmp_path / "theirs.csv", stacks_of(stack), images.index)
    assert counts_in(scored(images, records)).found == 4
    assert min(images.index) == "frames/000000.png"


def test_spots_that_do_not_belong_to_the_set_are_told_in_one_message(drawn, images, tmp_path):
    records = list(records_of(images, spot_at).values())
    lost = [replace(r, file_name=f"frames/{n}.png") for n, r in enumerate(records)]
    (tmp_path / "train").mkdir()
    for file, own, said in (
        ("lost.csv", lost, r"lost.csv.*'frames/0.png'.*and 11 more.*such as"),
        ("twice.csv", [*records, records[3]], f"{records[3].file_name} has two lines"),
        ("train/z.csv", [], "z.csv: the set has no stack train/z"),
    ):
        write_spots(tmp_path / file, own)
        given = tmp_path if "/" in file else tmp_path / file
        with pytest.raises(ValueError, match=said) as told:
            read_set_spots(given, stacks_of(drawn), images.index)
        assert "\n" not in str(told.value)
        (tmp_path / file).unlink()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["missing.csv"], "no such spots file"),
        (["a/x.csv", "b/x.csv"], "two estimators have the name x"),
        (["--mode", "subpixel", "--out", "."], "already exists"),
        (["--mode", "subpixel", "--calibration", "x.json"], "no effect without --mode auto"),
    ],
)
def test_what_cannot_be_scored_is_told(drawn, arguments, words):
    done = call(["score", str(drawn), *arguments])
    assert isinstance(done.exception, ValueError)
    assert words in str(done.exception)


def test_blur_is_counted_at_the_pole():
    scale = MICROSCOPE["scale_mm_px"]
    assert isinstance(scale, float)
    image = in_memory(1, speed_mm_s=2.0, exposure_s=0.05).assign(scale_mm_px=scale)
    assert with_derived(image).blur_px.item() == pytest.approx(0.1 * 858.2 / 23.0)
