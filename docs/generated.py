"""Writes the pages of the reference that come from the code: commands, scene keys, files, failures.

`docs/conf.py` calls `write_pages` before every build; nobody edits what it writes.
"""

import inspect
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from docs.failures import failures_page, table
from docs.schemas import KINDS, FileKind, rows_of, schema_of
from eyespot import command_line
from eyespot.benchmarks.explore import drawing, state_of
from eyespot.formats.report_page import UNITS, unit_at_end
from eyespot.scenes import Scene

_PICTURES = {
    "phantom": 1,
    "source": 2,
    "instrument": 6,
    "second_tool": 7,
    "motion": 8,
    "camera": 9,
    "microscope": 10,
    "viewing": 11,
}
"""Pictures of the gallery's example of scenes that show what a table of the scene does."""


def write_pages(folder: Path) -> None:
    """Write all pages into a folder, which is made if it is missing."""
    folder.mkdir(parents=True, exist_ok=True)
    pages = {
        "commands.md": [_commands()],
        "scene_keys.md": _scene_keys(),
        "files.md": _files(),
        "messages.md": failures_page(),
        "explore.svg": [_explored()],
    }
    for name, lines in pages.items():
        _write(folder / name, "\n".join(lines) + "\n")
    for kind in KINDS:
        _write(folder / _schema_name(kind), json.dumps(schema_of(kind), indent=1) + "\n")


def _write(path: Path, text: str) -> None:
    """Write a file only if it changes, so that Sphinx reads only what changed."""
    if not path.exists() or path.read_text(encoding="utf-8") != text:
        path.write_text(text, encoding="utf-8")


def _explored() -> str:
    """The pictures of `eyespot explore` in its usual state, side by side, for the first page."""
    pictures = drawing(state_of({}))
    del pictures["table"]
    side = 300
    placed = "".join(
        picture.replace("<svg ", f'<svg x="{side * n}" width="{side}" height="{side}" ', 1)
        for n, picture in enumerate(pictures.values())
    )
    box = f'viewBox="0 0 {side * len(pictures)} {side}" font-family="sans-serif"'
    paper = '<rect width="100%" height="100%" fill="#fff"/>'
    return f'<svg xmlns="http://www.w3.org/2000/svg" {box}>{paper}{placed}</svg>'


def _commands() -> str:
    for group in command_line.groups.values():
        for command in group.resolved_commands().values():
            command_line.show_docstring(command)
    return command_line.app.generate_docs().replace("# eyespot", "# Commands", 1)


def _scene_keys() -> Iterator[str]:
    yield "# Keys of a scene file\n"
    yield "`eyespot scene init FILE` writes a file with all of them, and `--set table.key=value`"
    yield "changes one for a single run. [The frame](../../theory/frame.md) says what is measured"
    yield "from where."
    yield "The pictures come from the [gallery](../../auto_gallery/index.rst)."
    for name, field in Scene.model_fields.items():
        kinds = _models_in(field.annotation)
        if not kinds:
            about = field.description or "Version of the format."
            yield f"\n## `{field.alias or name}`\n\n{about}\n"
        for number, model in enumerate(kinds):
            kind = model.model_fields.get("kind")
            title = f"[{name}]" + (f" kind = {kind.default!r}" if kind and len(kinds) > 1 else "")
            yield f"\n## `{title}`\n\n{inspect.cleandoc(model.__doc__ or '').splitlines()[0]}\n"
            if name in _PICTURES and number == 0:
                picture = f"images/sphx_glr_plot_scenes_{_PICTURES[name]:03}.png"
                yield f"```{{image}} ../../auto_gallery/scenes/{picture}\n:width: 320px"
                yield f":alt: An example of [{name}]\n```\n"
            yield from table("key | unit | default | meaning", _keys(model))


def _models_in(annotation: Any) -> list[type[BaseModel]]:
    """The pydantic models in an annotation, which may be a union."""
    if inspect.isclass(annotation) and issubclass(annotation, BaseModel):
        return [annotation]
    return [found for part in getattr(annotation, "__args__", ()) for found in _models_in(part)]


def _keys(model: type[BaseModel]) -> Iterator[tuple[str, str, str, str]]:
    for key, field in model.model_fields.items():
        default = "" if field.is_required() else f"`{json.dumps(field.default, default=str)}`"
        about = field.description or "Which kind of this table it is."
        yield f"`{key}`", UNITS.get(unit_at_end(key), ""), default, about


def _files() -> Iterator[str]:
    yield "# Files\n"
    yield "The keys of the files that eyespot reads and writes. Most files with an unknown key, a"
    yield "missing one, or a value outside of its range are refused with key, value and remedy."
    yield "Each kind of file has a JSON schema, for editors and other programs. A schema has the"
    yield "names, types and simple ranges; the reader also checks that the values fit together.\n"
    yield "Every format has a version, `schema`. Older files are read; a newer one is refused, with"
    yield "the way out."
    for kind in KINDS:
        schema = schema_of(kind)
        yield f"\n## {kind.title}\n"
        yield f"{kind.about} Schema: {{download}}`{_schema_name(kind)} <{_schema_name(kind)}>`.\n"
        if kind.slug == "scene":
            continue
        keys = ((f"`{k}`", type_, "yes" * must, about) for k, type_, must, about in rows_of(schema))
        yield from table("key | type | required | meaning", keys)


def _schema_name(kind: FileKind) -> str:
    return f"{kind.slug}.schema.json"
