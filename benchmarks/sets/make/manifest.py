"""Writes the manifest of a set, and verifies a set against it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field

from benchmarks.sets.read import HISTORY, SCHEMA, LabelledSet, SetError, read_set
from estimator.files import Strict, fingerprint, object_in, validated, written_whole
from optics import check_schema, in_file, read_text

MANIFEST = "manifest.json"
_MOST_BYTES = 2**29  # of the manifest: 4 million files
_NAMED = 20  # problems listed in a message; an incomplete copy has thousands


class _Manifest(Strict):
    schema_: Annotated[int, Field(alias="schema")]
    files: dict[str, dict[str, Any]]


def write_manifest(labelled: LabelledSet) -> None:
    """Write a list of all files of a set; files of a stack are taken from the stack's manifest."""
    files: dict[str, Any] = {}
    for stack in labelled.stacks:
        own = stack.folder / MANIFEST
        listed = {**json.loads(own.read_text())["files"], MANIFEST: fingerprint(own)}
        files |= {f"{stack.split}/{stack.name}/{name}": known for name, known in listed.items()}
    for path in _files(labelled.folder):
        name = path.relative_to(labelled.folder).as_posix()
        if name not in files and name != MANIFEST:
            files[name] = fingerprint(path)
    content = json.dumps({"schema": SCHEMA, "files": dict(sorted(files.items()))}, indent=1)
    with written_whole(labelled.folder / MANIFEST) as partial:
        partial.write_text(content + "\n")


def verify_set(folder: Path) -> int:
    """Verify that all files of a set exist unchanged, and that there are no other files.

    Returns:
        Number of files.

    Raises:
        SetError: files are missing, changed or unexpected; the message lists them.
    """
    labelled = read_set(folder)
    if missing := [f"{stack.split}/{stack.name}" for stack in labelled.missing]:
        raise SetError(_listed(folder, [f"stack {name} is missing" for name in missing]))
    try:
        with in_file(labelled.folder / MANIFEST, SetError):
            content = object_in(read_text(labelled.folder / MANIFEST, most_bytes=_MOST_BYTES))
            check_schema(content.get("schema"), HISTORY, remedy="Make the set again.")
            files = validated(_Manifest, content, remedy="Make the set again.").files
    except FileNotFoundError as error:
        raise SetError(
            f"{folder} is incomplete: {MANIFEST} is missing. Run `eyespot dataset` with its spec "
            "and this folder again."
        ) from error
    found = {path.relative_to(labelled.folder).as_posix() for path in _files(labelled.folder)}
    unlisted = sorted(found - files.keys() - {MANIFEST})
    problems = [f"{name} is not in {MANIFEST}" for name in unlisted]
    for name, known in files.items():
        if name not in found:
            problems.append(f"{name} is missing")
        elif fingerprint(labelled.folder / name) != known:
            problems.append(f"{name} differs from its checksum")
    if problems:
        raise SetError(_listed(folder, problems))
    return len(files)


def _files(folder: Path) -> list[Path]:
    return sorted(path for path in folder.rglob("*") if path.is_file())


def _listed(folder: Path, problems: list[str]) -> str:
    more = len(problems) - _NAMED
    lines = [f"{folder}: {problem}" for problem in problems[:_NAMED]]
    return "\n".join(lines + ([f"{folder}: and {more} more"] if more > 0 else []))
