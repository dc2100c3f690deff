"""The scene file (TOML): read with errors for people, written, explained, and its JSON schema."""

from __future__ import annotations

import difflib
import tomllib
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, get_args

import tomli_w
from pydantic import BaseModel, ValidationError

from scenes.description.motion_settings import MOTIONS
from scenes.description.settings import Scene, SceneError

_UNNAMED = "withdrawal"
"""The motion of a scene that names none."""


def load_scene(path: Path | None, changes: Sequence[str] = ()) -> Scene:
    """Read and validate a scene file (TOML).

    Args:
        path: the file; None for the scene of the defaults.
        changes: keys set after reading, each "table.key=value", the value as in TOML; the quotes
            of a string may be left out.

    Raises:
        SceneError: the file is missing, is no TOML, has unknown keys (the nearest known one is
            named) or describes an impossible geometry; or a change is no "key=value".
    """
    content = {} if path is None else _read(Path(path))
    for change in changes:
        content = _merged(content, parsed_change(change))
    where = " ".join([str(path or "the default scene"), *(f"--set {c}" for c in changes)])
    return _validated(content, where)


def changed(scene: Scene, changes: Mapping[str, Any]) -> Scene:
    """The scene with other values, {"table.key": value}; a new motion.kind brings its defaults.

    Raises:
        SceneError: a key is unknown, or the scene cannot be.
    """
    content = scene.model_dump(mode="json", by_alias=True)
    for key, value in changes.items():
        content = _merged(content, _nested(key.split("."), value))
    return _validated(content, "the changed scene")


def parsed_change(change: str) -> dict[str, Any]:
    """Tables of a change "table.key=value"; the value as in TOML, or else a string.

    Raises:
        SceneError: it is no "key=value".
    """
    key, equals, text = (part.strip() for part in change.partition("="))
    if not (key and equals):
        raise SceneError(f"a change is written table.key=value; got {change!r}.")
    try:
        value = tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        value = text
    return _nested(key.split("."), value)


def scene_toml(scene: Scene) -> str:
    """The scene as the text of a scene file."""
    return tomli_w.dumps(scene.model_dump(mode="json", by_alias=True))


def scene_schema() -> dict[str, Any]:
    """The JSON schema of scene files (draft 2020-12), for editors that complete and check keys."""
    draft = {"$schema": "https://json-schema.org/draft/2020-12/schema"}
    return draft | Scene.model_json_schema(by_alias=True)


def scene_template(*, schema_file: str | None = None) -> str:
    """A scene file with every key at its default, each explained.

    Args:
        schema_file: path of the JSON schema from the scene file's folder, for editors.
    """
    lines = [
        *([f"#:schema {schema_file}"] if schema_file else []),
        "# eyespot scene: lengths in mm, angles in degrees, inf allowed where it makes sense",
        f"schema = {Scene.model_fields['schema_version'].default}",
        f"seed = 0  # {Scene.model_fields['seed'].description}",
    ]
    for name, field in Scene.model_fields.items():
        if isinstance(field.default, BaseModel):
            lines += _table(name, type(field.default))
    return "\n".join(lines) + "\n"


def _read(path: Path) -> dict[str, Any]:
    try:
        return tomllib.loads(path.read_text())
    except OSError as error:
        raise SceneError(
            f"{path}: cannot be read ({error.strerror}). `eyespot scene init {path}` writes one."
        ) from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise SceneError(f"{path}: not a TOML file: {error}.") from error


def _nested(path: Sequence[str], value: Any) -> dict[str, Any]:
    for part in reversed(path):
        value = {part: value}
    return value


def _merged(content: Mapping[str, Any], change: Mapping[str, Any]) -> dict[str, Any]:
    """The content with the change's values; the keys of another kind of motion are dropped."""
    merged = dict(content)
    if change.get("kind") in MOTIONS and change["kind"] != content.get("kind", _UNNAMED):
        merged.clear()
    for key, value in change.items():
        old = merged.get(key)
        if isinstance(value, Mapping) and isinstance(old, Mapping):
            value = _merged(old, value)
        merged[key] = value
    return merged


def _validated(content: Mapping[str, Any], where: str) -> Scene:
    try:
        return Scene.model_validate(content)
    except ValidationError as error:
        problems = "\n".join(f"{where}: {_sentence(problem)}" for problem in error.errors())
        raise SceneError(problems) from error


def _table(name: str, model: type[BaseModel]) -> list[str]:
    """A table of the template; what may stand in its place follows as a comment."""
    lines = ["", f"# {_first_line(model)}", f"[{name}]"]
    lines += [_documented(key, field) for key, field in model.model_fields.items()]
    for other in MOTIONS.values() if model in MOTIONS.values() else ():
        if other is not model:
            keys = [_documented(key, field) for key, field in other.model_fields.items()]
            lines += ["", f"# Instead: {_first_line(other)}", f"# [{name}]"]
            lines += [f"# {key}" for key in keys]
    return lines


def _first_line(model: type[BaseModel]) -> str:
    return (model.__doc__ or "").splitlines()[0]


def _documented(key: str, field: Any) -> str:
    text = tomli_w.dumps({key: field.default}).strip()
    default = text.replace("\n    ", " ").replace(",\n]", " ]")
    choices = get_args(field.annotation)
    names = [repr(c) for c in choices if isinstance(c, str | int)]
    notes = [n for n in (" | ".join(names[len(names) == 1 :]), field.description) if n]
    return f"{default}  # {'. '.join(notes)}" if notes else default


def _sentence(problem: Any) -> str:
    path = list(problem["loc"])
    if path[:1] == ["motion"] and path[1:2] and path[1] in MOTIONS:
        del path[1]  # pydantic names the kind of motion; a scene file does not
    if problem["type"] == "union_tag_invalid":
        kinds = ", ".join(repr(kind) for kind in MOTIONS)
        where = ".".join(map(str, path))
        return f"{where}.kind: must be one of {kinds}; got {problem['ctx']['tag']!r}"
    return problem_sentence(problem, path, siblings=lambda: _siblings(problem["loc"]))


def problem_sentence(
    problem: Any, path: Sequence[int | str], *, siblings: Callable[[], list[str]]
) -> str:
    """What pydantic found wrong with a file's key, for people.

    Args:
        problem: of `ValidationError.errors()`.
        path: of the key, as the file has it.
        siblings: names of the keys of its table, for one that is unknown.
    """
    where = ".".join(str(part) for part in path)
    if problem["type"] == "extra_forbidden":
        near = difflib.get_close_matches(str(path[-1]), siblings(), n=1)
        hint = f"; did you mean {near[0]!r}?" if near else ""
        return f"unknown key {where!r}{hint}"
    message = problem["msg"].removeprefix("Value error, ")
    return f"{where}: {message}; got {problem['input']!r}" if where else message


def _siblings(location: tuple[int | str, ...]) -> list[str]:
    """Names of the keys of the table in which a key stands."""
    model: type[BaseModel] = Scene
    for part in location[:-1]:
        if part in MOTIONS:
            model = MOTIONS[str(part)]
        elif isinstance(default := model.model_fields[str(part)].default, BaseModel):
            model = type(default)
        else:
            return []
    return [field.alias or name for name, field in model.model_fields.items()]
