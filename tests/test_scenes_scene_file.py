"""The JSON schema of scene files against the files that the program itself takes and refuses."""

import json
import sys
import tomllib
from typing import Any

import jsonschema
import pytest
from pydantic import ValidationError

import eyespot
from scenes import Scene, scene_schema, scene_template


def accepted_by_schema(content: dict[str, Any]) -> bool:
    return jsonschema.Draft202012Validator(scene_schema()).is_valid(content)


def accepted_by_program(content: dict[str, Any]) -> bool:
    try:
        Scene.model_validate(content)
    except ValidationError:
        return False
    return True


def test_the_schema_is_a_schema():
    jsonschema.Draft202012Validator.check_schema(scene_schema())


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
        ({"schema": 2}, False),
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
    assert accepted_by_program(content) is good
    assert accepted_by_schema(content) is good


def run(monkeypatch, *arguments):
    monkeypatch.setattr(sys, "argv", ["eyespot", *map(str, arguments)])
    with pytest.raises(SystemExit) as exit_:
        eyespot.main()
    assert not exit_.value.code


def test_a_new_scene_file_names_the_schema_that_lies_beside_it(monkeypatch, capsys, tmp_path):
    run(monkeypatch, "scene", "init", tmp_path / "alone.toml")
    assert "#:schema" not in (tmp_path / "alone.toml").read_text()
    capsys.readouterr()
    run(monkeypatch, "scene", "schema")
    schema = capsys.readouterr().out
    assert json.loads(schema) == scene_schema()
    (tmp_path / "scene.schema.json").write_text(schema)
    run(monkeypatch, "scene", "init", tmp_path / "scene.toml")
    first, *rest = (tmp_path / "scene.toml").read_text().splitlines()
    assert first == "#:schema ./scene.schema.json"
    assert rest == (tmp_path / "alone.toml").read_text().splitlines()
