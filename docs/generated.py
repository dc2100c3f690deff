"""Writes the pages of the reference that come from the code: commands, scene keys, files, reasons.

`docs/conf.py` calls `write_pages` before every build; nobody edits what it writes.
"""

from __future__ import annotations

import importlib
import inspect
import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, Union, get_args, get_origin

import typer
from pydantic import BaseModel
from typer.cli import get_docs_for_click

import eyespot
from calibration.command.remedies import Fault, remedy
from estimator import Reason
from estimator.distance import Cause, RangeFlag
from scenes import Scene

_FILES = {
    "Scene": "scenes.description.scene:Scene",
    "Spec of a labelled set": "benchmarks.sets.spec.spec:SetSpec",
    "Set (`set.json`)": "benchmarks.sets.read.labelled_set:_SetFile",
    "Labels of a stack (`metadata.jsonl`)": "estimator.files.stack:FrameLabels",
    "Microscope (`microscope.json`)": "estimator.files.microscope:_PathFile",
    "Calibration": "estimator.files.calibration:_CalibrationFile",
    "Stated uncertainties": "estimator.files.stated:Stated",
    "Plan": "benchmarks.predictions.plan:_PlanFile",
    "Eye": "optics.viewing.eye_file:EyeFile",
}
_FIT_MODELS = ("plane", "sphere", "cone", "eye", "image", "lens")


def write_pages(folder: Path) -> None:
    """Write all pages into a folder, which is made if it is missing."""
    folder.mkdir(parents=True, exist_ok=True)
    pages = {
        "commands.md": _commands(),
        "scene_keys.md": "\n".join(_scene_keys()),
        "files.md": "\n".join(_files(folder)),
        "messages.md": "\n".join(_messages()),
    }
    for name, text in pages.items():
        _write(folder / name, text)


def _write(path: Path, text: str) -> None:
    """Write a file only if it changes, so that Sphinx reads only what changed."""
    if not path.exists() or path.read_text(encoding="utf-8") != text:
        path.write_text(text, encoding="utf-8")


def _commands() -> str:
    whole = typer.Typer(add_completion=False, help=eyespot.app.info.help)
    groups = {"": whole}
    for name, about in eyespot.GROUPS.items():
        groups[name] = typer.Typer(help=about)
        whole.add_typer(groups[name], name=name)
    for words, function in eyespot.COMMANDS.items():
        group, _, name = words.rpartition(" ")
        groups[group].command(name)(_named(function))
    command = typer.main.get_command(whole)
    text = get_docs_for_click(obj=command, ctx=typer.Context(command), name="eyespot")
    return text.replace("# `eyespot`", "# Commands", 1).replace("&#x27;", "'")


def _named(place: str) -> Any:
    """The object of a place "module:name"."""
    module, _, name = place.partition(":")
    return getattr(importlib.import_module(module), name)


def _scene_keys() -> Iterator[str]:
    yield "# Keys of a scene file\n"
    yield "`eyespot scene init FILE` writes a file with all of them. Lengths are in mm, angles in"
    yield "degrees. `--set table.key=value` changes one for a single run."
    for name, field in Scene.model_fields.items():
        kinds = _models_in(field.annotation)
        for model in kinds:
            kind = model.model_fields.get("kind")
            title = f"[{name}]" + (f" kind = {kind.default!r}" if kind and len(kinds) > 1 else "")
            yield f"\n## `{title}`\n\n{inspect.cleandoc(model.__doc__ or '').splitlines()[0]}\n"
            yield from _table(model)


def _models_in(annotation: Any) -> list[type[BaseModel]]:
    """The pydantic models in an annotation, which may be a union."""
    if inspect.isclass(annotation) and issubclass(annotation, BaseModel):
        return [annotation]
    return [found for part in getattr(annotation, "__args__", ()) for found in _models_in(part)]


def _table(model: type[BaseModel]) -> Iterator[str]:
    yield "| key | default | meaning |"
    yield "|---|---|---|"
    for key, field in model.model_fields.items():
        default = "" if field.is_required() else f"`{json.dumps(field.default, default=str)}`"
        yield f"| `{key}` | {default} | {_cell(field.description or '')} |"


def _cell(text: str) -> str:
    return text.replace("|", "\\|").replace("\n", " ")


def _files(folder: Path) -> Iterator[str]:
    yield "# Files\n"
    yield "The keys of the files that eyespot reads and writes. A file with an unknown key, a"
    yield "missing one, or a value outside of its range is refused with key, value and remedy."
    for title, place in _FILES.items():
        kind = _named(place)
        yield f"\n## {title}\n"
        module = importlib.import_module(place.partition(":")[0])
        yield inspect.cleandoc(module.__doc__ or "").splitlines()[0] + "\n"
        yield "| key | type | required | meaning |"
        yield "|---|---|---|---|"
        for key, type_name, required, meaning in _keys(kind):
            must = "yes" if required else ""
            yield f"| `{key}` | `{_cell(type_name)}` | {must} | {_cell(meaning)} |"
    yield "\n## Spots (CSV or Parquet)\n"
    spots = importlib.import_module("estimator.files.spots")
    yield inspect.cleandoc(spots.__doc__ or "") + "\n\nColumns, in this order: "
    yield ", ".join(f"`{name}`" for name in spots.COLUMNS) + "."
    _write(folder / "scene.schema.json", json.dumps(Scene.model_json_schema(), indent=1))
    yield "\nThe JSON schema of scene files: `eyespot scene schema`, or"
    yield "{download}`scene.schema.json <scene.schema.json>`."


def _keys(kind: Any) -> Iterator[tuple[str, str, bool, str]]:
    """Names, types, whether required, and meanings, of a pydantic model or a dataclass."""
    if issubclass(kind, BaseModel):
        for name, field in kind.model_fields.items():
            about = field.description or ""
            yield field.alias or name, _type_name(field.annotation), field.is_required(), about
        return
    for name, field in kind.__dataclass_fields__.items():
        yield name, str(field.type), field.default is not field.default, ""


def _type_name(annotation: Any) -> str:
    """A type without its ranges, which error messages name."""
    origin, parts = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        return _type_name(parts[0])
    if origin in (Union, UnionType):
        return " | ".join(_type_name(part) for part in parts)
    if origin in (list, dict, tuple):
        return f"{origin.__name__}[{', '.join(_type_name(part) for part in parts)}]"
    if annotation is type(None):
        return "None"
    return annotation.__name__ if inspect.isclass(annotation) else str(annotation)


def _messages() -> Iterator[str]:
    yield "# Reasons\n"
    yield "A result that is missing or doubtful has one of these reasons. Errors of input are not"
    yield "listed: each says what is wrong, with its value and unit, and the remedy.\n"
    yield "## Why a frame has no spot\n"
    yield "The column `reason` of a spots file, the console, and the node's diagnostics.\n"
    yield from _rows({reason.value: reason.meaning for reason in Reason})
    yield "\n## Why a distance is doubtful\n"
    yield from _rows({flag.value: flag.meaning for flag in RangeFlag})
    yield "\n## What makes a distance uncertain\n"
    yield "The column `largest_cause` of a spots file, and the node's diagnostics.\n"
    yield from _rows({cause.value: cause.meaning for cause in Cause})
    yield "\n## Why a fit is not good\n"
    yield "What `eyespot fit` says to try, by the model that was fitted.\n"
    yield "| criterion | model | try |"
    yield "|---|---|---|"
    for fault in Fault:
        tries = {model: remedy(fault, model=model) for model in _FIT_MODELS}
        for advice in dict.fromkeys(filter(None, tries.values())):
            models = ", ".join(model for model, said in tries.items() if said == advice)
            yield f"| {fault.name.lower().replace('_', ' ')} | {models} | {_cell(advice)} |"


def _rows(meanings: Mapping[str, str]) -> Iterator[str]:
    yield "| value | meaning and remedy |"
    yield "|---|---|"
    for value, meaning in meanings.items():
        yield f"| `{value}` | {_cell(meaning)} |"
