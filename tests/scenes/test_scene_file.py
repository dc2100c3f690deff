"""The JSON schema of scene files against the files that the program itself takes and refuses."""

import contextlib
import json
import math
import tomllib

import jsonschema
import pytest
import tomli_w
from pydantic import ValidationError

from eyespot.formats.inputs import InputError
from eyespot.scenes import Scene, SceneError, changed, load_scene, scene_schema, scene_template
from eyespot.scenes.world.world import World
from tests.support.command_line import printed


@pytest.mark.parametrize(
    ("content", "good"),
    [
        (tomllib.loads(scene_template()), True),
        ({"schema": 1}, True),
        ({"schema": 1, "motion": {}}, True),
        ({"schema": 1, "motion": {"speed_mm_s": 1.0}}, True),
        ({"schema": 1, "motion": {"kind": "scan", "speed_mm_s": 1.0}}, True),
        ({"schema": 1, "motion": {"kind": "hand", "damping": 0.5}}, True),
        ({"schema": 1, "motion": {"kind": "recorded", "file": "poses.csv"}}, True),
        ({"schema": 1, "motion": {"kind": "recorded", "damping": 0.5}}, False),
        ({"schema": 1, "motion": {"kind": "flight"}}, False),
        ({"schema": 2}, True),
        ({"schema": 3}, False),
        ({"schema": 1, "spot": {"incidense_deg": 30}}, False),
        ({"schema": 1, "camera": {"bit_depth": 17}}, False),
        ({"schema": 1, "camera": {"response": 2.2, "bayer": "RGGB"}}, True),
        ({"schema": 1, "camera": {"bayer": "RGB"}}, False),
        ({"schema": 1, "phantom": {"wall": "wood"}}, False),
        ({"schema": 1, "motion": {"start_mm": "contact"}}, True),
        ({"schema": 1, "motion": {"start_mm": "far"}}, False),
    ],
    ids=str,
)
def test_an_editor_with_the_schema_says_what_the_program_says(content, good):
    assert jsonschema.Draft202012Validator(scene_schema()).is_valid(content) is good
    with contextlib.nullcontext() if good else pytest.raises(ValidationError):
        Scene.model_validate(content)


def test_a_new_scene_file_names_the_schema_that_lies_beside_it(tmp_path):
    printed("scene", "init", tmp_path / "alone.toml")
    assert "#:schema" not in (tmp_path / "alone.toml").read_text()
    schema = printed("scene", "schema")
    assert json.loads(schema) == scene_schema()
    (tmp_path / "scene.schema.json").write_text(schema)
    printed("scene", "init", tmp_path / "scene.toml")
    first, *rest = (tmp_path / "scene.toml").read_text().splitlines()
    assert first == "#:schema ./scene.schema.json"
    assert rest == (tmp_path / "alone.toml").read_text().splitlines()


def test_a_change_on_the_command_line_is_the_same_as_in_the_file(tmp_path):
    file = tmp_path / "scene.toml"
    file.write_text('[motion]\nkind = "scan"\nlength_mm = 2.0\n[source]\nkind = "cone"\n')
    by_option = load_scene(
        None, ["motion.kind=scan", "motion.length_mm = 2.0", 'source.kind="cone"']
    )
    assert by_option == load_scene(file)
    assert changed(
        Scene(), {"motion.kind": "scan", "motion.length_mm": 2, "source.kind": "cone"}
    ) == (by_option)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ("source.lens=dome", "source.lens has no effect with source.kind = 'cone'"),
        ("phantom.wall_image=a.png", "phantom.wall_image has no effect with phantom.wall"),
        ("second_tool.gauge=25", "second_tool.gauge has no effect with second_tool.visible"),
    ],
)
def test_what_is_set_without_effect_is_said_and_a_default_in_a_file_is_not(tmp_path, change, said):
    file = tmp_path / "scene.toml"
    file.write_text(scene_template())
    assert load_scene(file, ["source.kind=cone"]).without_effect == []
    (found,) = load_scene(file, ["source.kind=cone", change]).without_effect
    assert found.startswith(said)


def test_the_real_microscope_has_a_name(tmp_path):
    file = tmp_path / "scene.toml"
    printed("scene", "init", file, "--microscope", "real")
    assert load_scene(file).microscope.pinhole_height_mm == 200.0
    printed("scene", "init", file, "--overwrite")
    assert load_scene(file) == Scene()


def test_a_change_leaves_all_other_keys_alone():
    scene = load_scene(None, ["motion.travel_mm=3", "spot.eccentricity_mm=2"])
    assert scene.motion == Scene().motion.model_copy(update={"travel_mm": 3.0})
    assert changed(scene, {"motion.kind": "withdrawal"}) == scene
    assert changed(scene, {"motion.kind": "hand"}).spot == scene.spot


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("motion.travel=3", "--set motion.travel=3: unknown key 'motion.travel'; did you mean"),
        ("withdrawal.frames=3", "unknown key 'withdrawal'"),
        ("spot.eccentricity_mm=far", "spot.eccentricity_mm: .* got 'far'"),
        ("seed", "a change must have the form table.key=value; got 'seed'"),
        ("=3", "a change must have the form table.key=value; got '=3'"),
        ("spot=3", "spot: .* got 3"),
    ],
)
def test_a_change_that_cannot_be_is_named(change, message):
    with pytest.raises(InputError, match=message):
        load_scene(None, [change])


WIDE = {"kind": "cone", "cone_k": 11.6, "cone_apex_offset_mm": -5.117}


def test_the_apex_follows_from_the_core_unless_it_is_given():
    wide = Scene.model_validate({"source": {"kind": "cone", "cone_k": 8.27}})
    # -b/k is the radius at the tip, whatever k is.
    assert wide.source.cone_apex_offset_mm == pytest.approx(-8.27 * 0.25585)
    narrower = changed(wide, {"source.cone_k": 12.0})
    assert narrower.source.cone_apex_offset_mm == pytest.approx(-12.0 * 0.25585)
    given = changed(wide, {"source.cone_apex_offset_mm": -1.2})
    assert given.source.cone_core_radius_mm == pytest.approx(1.2 / 8.27)
    assert changed(given, {"source.cone_k": 12.0}).source.cone_apex_offset_mm == -1.2
    with pytest.raises(ValidationError, match=r"contradict each other; got 0\.2 mm and b = -3 mm"):
        Scene.model_validate({"source": {"cone_core_radius_mm": 0.2, "cone_apex_offset_mm": -3}})


def test_a_new_cone_that_is_wider_than_its_fibre_is_refused_with_both_radii(tmp_path):
    with pytest.raises(ValidationError, match=r"radius of 0\.441 mm .* in a fibre of 0\.250 mm"):
        Scene.model_validate({"source": WIDE})
    # Light of a lens does not use the ideal cone.
    assert Scene.model_validate({"source": WIDE | {"kind": "lens"}})
    file = tmp_path / "scene.toml"
    file.write_text(tomli_w.dumps({"source": WIDE}))
    with pytest.raises(SceneError, match="wider at the tip"):
        load_scene(file)


def test_an_old_cone_that_is_wider_than_its_fibre_touches_with_its_own_edge(tmp_path):
    file = tmp_path / "scene.toml"
    spot = {"incidence_deg": 30.0}
    old = {"schema": 1, "source": WIDE, "phantom": {"kind": "plane"}, "spot": spot}
    file.write_text(tomli_w.dumps(old))
    # On a plane the rim of a tip that leans by iota touches at d = rho tan(iota).
    assert World(load_scene(file)).contact_distance == pytest.approx(
        5.117 / 11.6 * math.tan(math.pi / 6)
    )
    new = changed(Scene(), {"source.kind": "cone", "phantom.kind": "plane"})
    narrow = changed(new, {"source.cone_core_radius_mm": 0.2})
    assert World(narrow).contact_distance == pytest.approx(0.25 * math.tan(math.pi / 6))
