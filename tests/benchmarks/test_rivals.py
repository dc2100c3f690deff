"""Rivals: every entry measures a spot whose ellipse is known, and misses where there is none."""

import json
import math
import os
import shutil
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from eyespot.benchmarks.rivals import running
from eyespot.benchmarks.rivals.entries import KINDS, Entry
from eyespot.benchmarks.rivals.pupil import why_unavailable
from eyespot.benchmarks.rivals.running import read_constants, run, tune
from eyespot.benchmarks.sets.read import plain_spot, stacks_of
from eyespot.benchmarks.sets.score.judging import images_of
from eyespot.benchmarks.sets.score.scored_spots import read_set_spots
from eyespot.benchmarks.sets.spec import load_spec, named_specs, plan
from eyespot.estimator import Frame
from eyespot.formats.inputs import InputError
from eyespot.formats.microscope import read_microscope
from eyespot.formats.spot import NoSpot, Spot
from eyespot.scenes import Scene
from eyespot.scenes.drawn import Drawing, Truth, erf_edge, frame_of
from eyespot.scenes.world.true_calibration import true_calibration
from tests.benchmarks.test_dataset import here

WRITTEN = Path(__file__).parents[1] / "files-0.1" / "small-v1" / "train" / "0000"
TRUTH = Truth(x=301.3, y=222.8, semi_major=66.2, semi_minor=58.4, angle=0.6)
# A level that is right for one exposure: that of the drawing.
HALF = Drawing(truth=TRUTH).ambient + Drawing(truth=TRUTH).amplitude / 2
AT_HALF: dict[str, dict[str, Any]] = {"literal": {"threshold": round(HALF)}}
ALONE = ("opencv-relative", "skimage-ransac")


@pytest.fixture
def worker_here(monkeypatch):
    monkeypatch.setattr(running, "local_workers", lambda count: here())


def measured(name: str, image: np.ndarray, constants: Mapping[str, Any] | None = None) -> Any:
    known = read_constants().get(name, {}) if constants is None else constants
    entry: Entry = KINDS[name].make(known)
    beam = true_calibration(Scene.model_validate({"schema": 1, "source": {"kind": "cone"}}))
    entry.begin(read_microscope(WRITTEN / "microscope.json"), beam, (TRUTH.x, TRUTH.y))
    result = entry.read(Frame(index=0, time_s=0.0, image=image)).result
    entry.close()
    return result


@pytest.mark.parametrize(
    ("name", "tolerance_px"),
    [
        # Noise of 3 grey values on an edge 2 px wide leaves 0.02 px (the Cramér-Rao bound).
        ("subpixel", 0.1),
        # A contour through whole pixels: up to half a pixel, and a level that noise of 3 greys
        # and the blur before it move by a fraction of the edge's width of 2 px.
        *((name, 1.0) for name in ("literal", *ALONE)),
    ],
)
def test_an_entry_finds_the_ellipse_that_was_drawn(name, tolerance_px):
    image = frame_of(Drawing(truth=TRUTH), np.random.default_rng(1))
    spot = measured(name, image, AT_HALF.get(name))
    assert isinstance(spot, Spot)
    found = np.array(spot.ellipse)
    wanted = TRUTH.x, TRUTH.y, TRUTH.semi_major, TRUTH.semi_minor
    assert np.abs(found[:4] - wanted).max() < tolerance_px
    # The axes differ by 7.8 px: an error of the ellipse turns it by that over the difference.
    assert abs(math.remainder(found[4] - TRUTH.angle, math.pi)) < max(tolerance_px, 0.2) / 7.8 * 2


@pytest.mark.slow  # builds an environment
def test_pupil_detectors_finds_the_ellipse_that_was_drawn():
    if reason := why_unavailable():
        pytest.skip(reason)
    # It is tuned on lenses' spots, whose edges are that wide, and finds no sharp ones.
    drawing = Drawing(truth=TRUTH, profile=erf_edge(6.0))
    spot = measured("pupil-detectors", frame_of(drawing, np.random.default_rng(1)))
    assert isinstance(spot, Spot)
    # Its contour lies on pixels of a frame of a third of the size.
    assert abs(spot.semi_minor_px - TRUTH.semi_minor) < 4


def test_an_entry_that_can_refuse_does_where_there_is_no_spot():
    truth = replace(TRUTH, semi_major=60.0, semi_minor=60.0)
    for seed in range(10):
        rng = np.random.default_rng(seed)
        empty = frame_of(Drawing(truth=truth, amplitude=0.0), rng)
        assert isinstance(measured("subpixel", empty), NoSpot)


def test_a_plain_spot_has_its_longer_axis_first_whichever_is_given_first():
    wanted = plain_spot(1.0, 2.0, 30.0, 20.0, 0.4).ellipse
    for turns in (-1, 0, 1, 2):
        same = plain_spot(1.0, 2.0, 30.0, 20.0, 0.4 + turns * math.pi).ellipse
        other = plain_spot(1.0, 2.0, 20.0, 30.0, 0.4 + (turns + 0.5) * math.pi).ellipse
        # Rounding of an angle of a few pi.
        assert np.allclose([same, other], [wanted, wanted], atol=1e-12)


def run_on(folder: Path, out: Path, split: str) -> None:
    constants = out.with_name("constants.json")
    constants.write_text('{"entries": {"opencv-relative": {"constants": {"level": 0.5}}}}')
    run(folder, out=out, names=ALONE, splits=(split,), constants=constants, workers=1)


@pytest.mark.usefixtures("worker_here")
def test_what_the_entries_write_is_what_a_score_reads(drawn, tmp_path):
    out = tmp_path / "out"
    run_on(drawn, out, "train")
    stacks = stacks_of(drawn)
    for name in ALONE:
        records = read_set_spots(out / name, stacks, images_of(stacks).index)
        # Four images of stack a, and of stack b four in each of its two exposures.
        assert len(records) == 12
        assert all(record.file_name.startswith("train/") for record in records.values())
        assert all(isinstance(record.result, Spot) for record in records.values())
        about = json.loads((out / name / "entry.json").read_text())
        assert about["name"] == name
        assert about["ms_per_frame"] > 0


@pytest.mark.slow  # 30 s of training
def test_the_example_of_a_learned_estimator_learns_the_spots_that_it_is_shown(tmp_path):
    home = Path(__file__).parents[2]
    example = home / "docs/gallery/reading/learned_estimator.py"
    shown = home / "benchmarks/sets/score/sample-v2/test"
    (tmp_path / "train").symlink_to(shown)
    words = [tmp_path, "train", tmp_path / "network", "100"]
    # As a script; eyespot switches JAX to double precision, also for programs that it starts.
    single = os.environ | {"JAX_ENABLE_X64": "0"}
    subprocess.run([sys.executable, example, *words], check=True, env=single)
    found = pd.read_csv(tmp_path / "network" / "spots.csv")
    labels = pd.read_json(shown / "metadata.jsonl", lines=True)
    labels = labels.set_index("train/" + labels.file_name).loc[found.file_name]
    assert len(found) == np.sum(labels.visible_fraction >= 0.5)
    truth = labels.half_max_semi_minor_px
    # Who says their mean is off by their standard deviation.
    assert np.std(found.semi_minor_px.to_numpy() - truth) < 0.6 * np.std(truth)


def test_a_file_that_is_no_table_of_constants_is_named(drawn, tmp_path):
    (tmp_path / "other.json").write_text("[]")
    with pytest.raises(InputError, match=r"other\.json: not a file of `eyespot rivals tune`"):
        read_constants(tmp_path / "other.json")


def test_a_split_that_the_set_lacks_is_named(drawn, tmp_path):
    with pytest.raises(InputError, match="no split test"):
        run_on(drawn, tmp_path / "out", "test")


@pytest.mark.usefixtures("worker_here")
def test_tuning_sees_the_split_train_only_and_finds_the_better_level(drawn, tmp_path):
    """Frames of the other split are removed, so that reading them would fail."""
    folder = shutil.copytree(drawn, tmp_path / "set")
    for image in (folder / "adverse").rglob("*.png"):
        image.unlink()
    tune(folder, out=tmp_path / "c.json", names=("opencv-relative",), every=1, workers=1)
    found = json.loads((tmp_path / "c.json").read_text())
    assert found["stacks"] == ["train/a", "train/b"]
    # Drawn edges are symmetric: their half maximum is the middle between dark and bright.
    assert abs(found["entries"]["opencv-relative"]["constants"]["level"] - 0.5) <= 0.1


def test_no_wall_of_a_named_set_was_shown_in_tuning():
    shown = load_spec(Path(running.__file__).with_name("training.toml"))
    walls = {stack.scene.phantom.texture_seed for stack in plan(shown)}
    for name in named_specs():
        others = {stack.scene.phantom.texture_seed for stack in plan(load_spec(name))}
        assert not walls & others, name


def test_every_free_constant_of_an_entry_is_in_the_file_that_comes_with_eyespot():
    known = read_constants()
    for name, kind in KINDS.items():
        assert set(known.get(name, {})) == set(kind.grid), name
        assert all(known[name][constant] in values for constant, values in kind.grid.items())
