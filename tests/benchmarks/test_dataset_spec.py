"""Specs of labelled sets: what is refused, and how stacks are drawn."""

import itertools
import math
import re
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from eyespot.benchmarks.sets.asked import asked_and_drawn
from eyespot.benchmarks.sets.read import LabelledSet, SetStack
from eyespot.benchmarks.sets.spec import SEED_KEYS, SetSpec, draw, load_spec, named_specs, plan
from eyespot.formats.inputs import InputError
from eyespot.scenes import Scene, SceneError, changed, check_scene, scene_toml

PLAIN = """\
name = "plain"
description = "Sixteen stacks."
seed = 3
[splits]
train = 8
validation = 4
test = 4
[scene]
source.kind = "cone"
[vary]
spot.eccentricity_mm = { uniform = [0.0, 8.0] }
source.cone_k = { log_uniform = [5.0, 80.0] }
phantom.wall = { choice = ["retina", "uniform"] }
"""

ADVERSE = """
[adverse]
stacks = 2
[adverse.conditions.blur]
motion.speed_mm_s = 4.0
motion.kind = "scan"
[adverse.conditions.dim]
spot.eccentricity_mm = 1.0
source.power_mw = { uniform = [0.1, 0.2] }
"""


@pytest.fixture
def load(tmp_path):
    def load_text(text: str, changes: tuple[str, ...] = ()) -> SetSpec:
        file = tmp_path / "spec.toml"
        file.write_text(text)
        return load_spec(file, changes)

    return load_text


def values(spec: SetSpec, split: str, key: str) -> list[Any]:
    return [stack.parameters[key] for stack in plan(spec) if stack.split == split]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("seed", "sed", r"unknown key 'sed'; did you mean 'seed'\?"),
        ("validation", "validate", r"unknown key 'splits.validate'; did you mean 'validation'\?"),
        ("uniform = [0.0, 8.0]", "unifrom = [0.0, 8.0]", "must be a distribution, one of uniform"),
        ("[0.0, 8.0]", "[8.0, 0.0]", r"an interval must be \[low, high\].*got \[8, 0\]"),
        ("[5.0, 80.0]", "[0.0, 80.0]", r"must lie above 0; got \[0, 80\]"),
        ('"retina", "uniform"', '"retina"', "at least 2 items"),
        ('["retina", "uniform"]', "[1.0, inf]", "finite values"),
        ("source.kind", "phantom.texture_seed", "its own seed from the set's"),
        ("train = 8", "train = -8", "splits.train: .*greater than or equal to 0; got -8"),
        ("[splits]", "[splits", "not a TOML file"),
    ],
)
def test_a_broken_spec_is_answered_with_what_to_change(load, old, new, message):
    with pytest.raises(InputError, match=message):
        load(PLAIN.replace(old, new, 1))


def test_a_scene_key_that_does_not_exist_is_answered_with_the_nearest_one(load):
    with pytest.raises(SceneError, match=r"train/0000: .*cone_l.*did you mean 'cone_k'\?"):
        plan(load(PLAIN.replace("cone_k", "cone_l")))


def near(scene):
    if scene.spot.eccentricity_mm > 6.0:
        raise SceneError(f"{scene.spot.eccentricity_mm:.3f} mm is too far out")


def test_a_set_whose_scenes_are_not_all_possible_is_refused(load):
    # Each split's points are even, so that a fourth of the eccentricities of 0 to 8 is above 6.
    with pytest.raises(SceneError, match=r"4 of 16 stacks are impossible.*too far out") as caught:
        plan(load(PLAIN), near)
    assert "Narrow [vary]" in str(caught.value)


def test_impossible_scenes_are_left_out_with_their_condition_if_the_spec_says_so(load):
    spec = load('impossible = "leave out"\n' + PLAIN)
    drawn = draw(spec, near)
    assert [stack for stack in plan(spec) if stack in drawn.stacks] == drawn.stacks
    assert len(drawn.stacks) == 12
    for one in drawn.impossible:
        assert one.parameters["spot.eccentricity_mm"] > 6.0
        assert f"{one.parameters['spot.eccentricity_mm']:.3f} mm is too far out" == str(one.problem)


def test_the_window_that_a_refusal_proposes_shows_every_spot(load):
    # At k 4 and d = 6 mm the spot is 2 (0.256 + 6/4) = 3.5 mm wide, 524 px of 0.0067 mm.
    spec = load(PLAIN.replace("[0.0, 8.0]", "[0.0, 2.0]").replace("[5.0, 80.0]", "[4.0, 8.0]"))
    with pytest.raises(SceneError) as caught:
        plan(spec, check_scene)
    sizes = re.findall(r"--set microscope\.(\w+)=(\d+)", str(caught.value))
    changes = {f"microscope.{key}": int(value) for key, value in sizes}
    assert [*changes] == ["microscope.width_px", "microscope.height_px"]
    wide = spec.model_copy(update={"scene": spec.scene | changes})
    assert len(plan(wide, check_scene)) == 16


def test_the_card_says_which_combinations_are_missing():
    """Wide tilts of one lens are missing: a cell of half an interval and a lens is empty."""
    vary = {"spot.incidence_deg": {"uniform": [0, 40]}, "source.lens": {"choice": ["a", "b"]}}
    stacks = [
        SetStack(
            split="train",
            name=f"{lens}{tilt}",
            condition=None,
            parameters={"spot.incidence_deg": tilt, "source.lens": lens},
            folder=Path(),
        )
        for tilt, lens in itertools.product(np.arange(0.5, 40.0), "ab")
        if lens == "b" or tilt < 20
    ]
    names: dict[str, Any] = {"name": "x", "licence": "y", "description": {"spec": {"vary": vary}}}
    parameters, pairs = asked_and_drawn(LabelledSet(folder=Path(), stacks=tuple(stacks), **names))
    tilt, lens = parameters.itertuples(index=False)
    assert (tilt.asked, tilt.drawn) == ("uniform, 0 to 40", "0.5 to 39.5")
    # Of 60 stacks 40 tilt by less than 20 degrees, half of the interval; a step is 1/60.
    assert tilt.difference == pytest.approx(40 / 60 - 0.5, abs=1 / 60)
    assert lens.drawn == "a: 20, b: 40"
    assert lens.difference == pytest.approx(2 / 3 - 1 / 2)
    (pair,) = pairs.itertuples(index=False)
    assert (pair.cell, pair.asked, pair.drawn) == ("20 to 40 with a", 0.25, 0.0)


def test_an_impossible_draw_names_its_stack_before_anything_is_rendered(load):
    # An eyeball of 11.5 mm has no wall at eccentricity 20 mm.
    with pytest.raises(SceneError, match=r"(train|validation|test)/000\d: .*eccentricity_mm"):
        plan(load(PLAIN.replace("[0.0, 8.0]", "[12.0, 20.0]")))


def test_a_spec_that_does_not_exist_names_those_that_do(tmp_path):
    with pytest.raises(InputError, match="static-v1"):
        load_spec(tmp_path / "missing.toml")


def test_a_key_that_is_set_varies_no_longer(load):
    spec = load(PLAIN, ("spot.eccentricity_mm = 2.5", 'phantom.wall = "uniform"'))
    assert {stack.scene.spot.eccentricity_mm for stack in plan(spec)} == {2.5}
    assert {stack.scene.phantom.wall for stack in plan(spec)} == {"uniform"}
    assert len(set(values(spec, "train", "source.cone_k"))) == 8


def test_a_scene_file_is_what_all_stacks_have(load, tmp_path):
    scene = Scene.model_validate({"seed": 5, "instrument": {"gauge": 25}, "clocks": {"seed": 4}})
    (tmp_path / "scene.toml").write_text(scene_toml(scene))
    text = PLAIN.replace('[scene]\nsource.kind = "cone"\n', "")
    spec = load('scene = "scene.toml"\n' + text)
    assert {stack.scene.instrument.gauge for stack in plan(spec)} == {25}
    assert len({stack.scene.clocks.seed for stack in plan(spec)}) == 16


def test_what_a_set_says_of_its_spec_makes_the_same_stacks(load):
    spec = load(PLAIN + ADVERSE)
    written = spec.model_dump(mode="json", by_alias=True, exclude_none=True)
    assert plan(SetSpec.model_validate(written)) == plan(spec)


@pytest.mark.parametrize(("split", "count"), [("train", 8), ("validation", 4), ("test", 4)])
def test_every_split_covers_each_distribution_evenly_by_itself(load, split, count):
    # A block of 2^m points of a Sobol sequence has one in each 2^m-th part of every axis
    # (Sobol 1967); the quantile of an interval and of its logarithm is uniform.
    spec = load(PLAIN)
    eccentricity = np.array(values(spec, split, "spot.eccentricity_mm")) / 8.0
    cone = np.log(np.array(values(spec, split, "source.cone_k")) / 5.0) / math.log(80.0 / 5.0)
    for quantile in (eccentricity, cone):
        assert sorted(np.floor(quantile * count)) == list(range(count))
    assert Counter(values(spec, split, "phantom.wall")) == {
        "retina": count / 2,
        "uniform": count / 2,
    }


@pytest.mark.parametrize("name", named_specs())
def test_no_two_stacks_share_noise_wall_motion_or_place(name):
    spec = load_spec(name)
    stacks = [stack for stack in plan(spec) if stack.pair is None]
    for key in SEED_KEYS:
        seeds = [seed for stack in stacks if (seed := seed_of(stack.scene, key)) is not None]
        assert len(set(seeds)) == len(seeds)
    places = {(s.scene.spot.eccentricity_mm, s.scene.spot.incidence_deg) for s in stacks}
    assert len(places) == len(stacks)
    assert len({(stack.split, stack.name) for stack in stacks}) == len(stacks)


@pytest.mark.slow
@pytest.mark.parametrize("name", named_specs())
def test_every_scene_of_a_named_set_can_be_rendered(name):
    spec = load_spec(name)
    assert plan(spec, check_scene) == plan(spec)  # none is impossible


def test_no_two_named_sets_share_a_seed_or_lack_the_licence():
    specs = [load_spec(name) for name in named_specs()]
    assert [spec.name for spec in specs] == named_specs()
    assert {spec.licence for spec in specs} == {"CC-BY-4.0"}
    seeds = [stack.scene.seed for spec in specs for stack in plan(spec) if stack.pair is None]
    assert len(set(seeds)) == len(seeds)


def test_more_stacks_of_a_split_leave_those_there_are(load):
    # Up to the next power of two, which every split's block has room for.
    few, more = (plan(load(PLAIN.replace("test = 4", f"test = {n}"))) for n in (3, 7))
    assert [stack for stack in more if stack in few] == few


def test_a_condition_changes_what_it_names_and_keeps_what_else_varies(load):
    stacks = [stack for stack in plan(load(PLAIN + ADVERSE)) if stack.split == "adverse"]
    assert [stack.name for stack in stacks] == ["blur-0000", "blur-0001", "dim-0000", "dim-0001"]
    blur, dim = stacks[:2], stacks[2:]
    assert {stack.scene.motion.kind for stack in blur} == {"scan"}
    assert {stack.scene.motion.kind for stack in dim} == {"withdrawal"}
    assert len({stack.scene.spot.eccentricity_mm for stack in blur}) == 2
    assert {stack.scene.spot.eccentricity_mm for stack in dim} == {1.0}
    assert all(0.1 <= stack.scene.source.power_mw <= 0.2 for stack in dim)
    assert {stack.parameters["source.power_mw"] for stack in blur} == {1.0}


def test_a_split_of_unseen_walls_changes_no_other_split(load):
    plain = load(PLAIN + ADVERSE)
    both = plan(
        load(f'{PLAIN}{ADVERSE}[unseen]\nstacks = 3\nchanges.phantom.wall = "photograph"\n')
    )
    assert [stack.scene for stack in both[:-3]] == [stack.scene for stack in plan(plain)]
    assert {stack.split for stack in both[-3:]} == {"unseen"}
    assert {stack.scene.phantom.wall for stack in both[-3:]} == {"photograph"}
    assert len({stack.scene.phantom.texture_seed for stack in both}) == len(both)


def test_partners_of_a_pair_differ_in_nothing_but_what_the_pair_says(load):
    alone = plan(load(PLAIN))
    stacks = plan(load(PLAIN + "[pairs.high]\nmicroscope.pinhole_height_mm = 200.0\n"))
    first, partners = ([s for s in stacks if s.pair == name] for name in (None, "high"))
    assert [s.scene for s in first] == [s.scene for s in alone]
    for one, other in zip(first, partners, strict=True):
        assert other.name == f"{one.name}-high"
        assert other.split == one.split
        assert other.scene == changed(one.scene, {"microscope.pinhole_height_mm": 200.0})
        assert one.parameters["microscope.pinhole_height_mm"] == 11.5


def seed_of(scene: Scene, key: str) -> int | None:
    table, _, name = key.rpartition(".")
    return getattr(getattr(scene, table) if table else scene, name, None)
