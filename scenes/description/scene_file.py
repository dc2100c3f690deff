"""Scene files (TOML): reading, changing, writing, the commented template and the JSON schema."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import tomli_w
from pydantic import BaseModel, ValidationError

from eyespot.formats.inputs import (
    at_most_three,
    check_schema,
    in_file,
    read_toml,
    shortened,
)
from eyespot.formats.settings_files import (
    documented,
    first_line,
    merged,
    nested,
    parsed_change,
    problem_sentence,
    table_lines,
)
from eyespot.scenes.description.scene import Scene
from eyespot.scenes.description.scene_keys import (
    CONE_AT_THE_TIP,
    MOTIONS,
    OF_THE_RETINA,
    UNNAMED,
    SceneError,
)

HISTORY = {
    1: "the format of eyespot 0.1",
    2: "b of a cone follows from its core, and no cone is wider than its fibre; a file without "
    "`schema` has this one",
}
"""What changed with each version of the format that is read."""


def load_scene(path: Path | None, changes: Sequence[str] = ()) -> Scene:
    """Read and validate a scene file (TOML).

    Args:
        path: the file; None for the default scene.
        changes: keys to set after reading, each "table.key=value" with the value as in TOML; the
            quotes of a string may be omitted.

    Raises:
        SceneError: the file is missing, is not TOML, has unknown keys (the message suggests the
            nearest known key) or describes an impossible geometry; or a change is not "key=value".
    """
    content = {} if path is None else _read(Path(path))
    for change in changes:
        content = _merged(content, parsed_change(change))
    changed_by = (f"--set {shortened(change)[1:-1]}" for change in changes)
    where = " ".join([str(path or "the default scene"), *changed_by])
    return _validated(content, where)


def changed(scene: Scene, changes: Mapping[str, Any]) -> Scene:
    """The scene with other values, {"table.key": value}; a new motion.kind sets its defaults.

    Raises:
        SceneError: a key is unknown, or the changed scene is invalid.
    """
    content = scene.model_dump(mode="json", by_alias=True)
    given = scene.source.model_fields_set
    core, apex = CONE_AT_THE_TIP
    kept = core if f"source.{core}" in changes else apex if apex in given else core
    content["source"] = {k: v for k, v in content["source"].items() if k not in CONE_AT_THE_TIP}
    if kept in given:
        content["source"][kept] = getattr(scene.source, kept)
    if any(key.startswith("viewing.") for key in changes):
        # An eye brings its own retina.
        content["phantom"] = {k: v for k, v in content["phantom"].items() if k not in OF_THE_RETINA}
    for key, value in changes.items():
        text = str(value) if isinstance(value, Path) else value
        content = _merged(content, nested(key.split("."), text))
    return _validated(content, "the changed scene")


def scene_toml(scene: Scene) -> str:
    """The scene as the text of a scene file."""
    return tomli_w.dumps(scene.model_dump(mode="json", by_alias=True))


def scene_schema() -> dict[str, Any]:
    """The JSON schema of scene files (draft 2020-12), for editors that complete and check keys."""
    draft = {"$schema": "https://json-schema.org/draft/2020-12/schema"}
    return draft | Scene.model_json_schema(by_alias=True)


def scene_template(*, schema_file: str | None = None) -> str:
    """A scene file with every key at its default value, each with an explanation.

    Args:
        schema_file: path of the JSON schema, relative to the scene file's folder, for editors.
    """
    lines = [
        *([f"#:schema {schema_file}"] if schema_file else []),
        "# Scene of eyespot. Lengths are in mm, angles in degrees. Some lengths may be inf.",
        f"schema = {Scene.model_fields['schema_version'].default}",
        f"seed = 0  # {Scene.model_fields['seed'].description}",
    ]
    for name, field in Scene.model_fields.items():
        if isinstance(field.default, BaseModel):
            lines += _table(name, type(field.default))
    return "\n".join(lines) + "\n"


def _read(path: Path) -> dict[str, Any]:
    try:
        with in_file(path, SceneError):
            content = read_toml(path)
            check_schema(content.get("schema", 2), HISTORY, remedy="Write 2.")
            return content
    except OSError as error:
        raise SceneError(
            f"{path}: cannot be read ({error.strerror}). `eyespot scene init {path}` writes one."
        ) from error


def _merged(content: Mapping[str, Any], change: Mapping[str, Any]) -> dict[str, Any]:
    """The content with the changed values; a new kind of motion drops the keys of the old one."""
    motion = change.get("motion")
    kind = motion.get("kind") if isinstance(motion, Mapping) else None
    old = content.get("motion", {})
    known = isinstance(kind, str) and kind in MOTIONS
    if known and isinstance(old, Mapping) and kind != old.get("kind", UNNAMED):
        content = {**content, "motion": {}}
    return merged(content, change)


def _validated(content: Mapping[str, Any], where: str) -> Scene:
    try:
        return Scene.model_validate(content)
    except ValidationError as error:
        problems = [f"{where}: {_sentence(problem)}" for problem in error.errors()]
        raise SceneError(at_most_three(problems)) from error


def _table(name: str, model: type[BaseModel]) -> Iterator[str]:
    """A table of the template; the other kinds of motion follow as comments."""
    yield from table_lines(name, model)
    for other in MOTIONS.values() if model in MOTIONS.values() else ():
        if other is not model:
            yield from ("", f"# Or: {first_line(other)}", f"# [{name}]")
            yield from (f"# {documented(*item)}" for item in other.model_fields.items())


def _sentence(problem: Any) -> str:
    path = list(problem["loc"])
    if path[:1] == ["motion"] and path[1:2] and path[1] in MOTIONS:
        del path[1]  # pydantic names the kind of motion; a scene file does not
    if problem["type"] == "union_tag_invalid":
        kinds = ", ".join(repr(kind) for kind in MOTIONS)
        where = ".".join(map(str, path))
        return f"{where}.kind: must be one of {kinds}; got {shortened(problem['ctx']['tag'])}"
    return problem_sentence(problem, path, siblings=lambda: _siblings(problem["loc"]))


def _siblings(location: tuple[int | str, ...]) -> list[str]:
    """The known keys of the table that contains a key."""
    model: type[BaseModel] = Scene
    for part in location[:-1]:
        if part in MOTIONS:
            model = MOTIONS[str(part)]
        elif isinstance(default := model.model_fields[str(part)].default, BaseModel):
            model = type(default)
        else:
            return []
    return [field.alias or name for name, field in model.model_fields.items()]
