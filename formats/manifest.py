"""Manifest of a folder: size and SHA-256 of every file in it, and what differs from that."""

import hashlib
import json
import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field

from eyespot.formats.inputs import (
    Strict,
    check_schema,
    in_file,
    inside,
    object_in,
    read_text,
    validated,
)
from eyespot.formats.whole_files import write_text

MANIFEST = "manifest.json"
HISTORY = {1: "the format of eyespot 0.1"}

_MAX_MANIFEST_BYTES = 2**29  # the manifest of a set of 10,000 stacks has 100 MB

Fingerprint = dict[str, Any]
"""Size and checksum of a file."""


class _Fingerprint(Strict):
    bytes: int = Field(description="Size of the file.")
    sha256: str = Field(description="Of the file.")


class _Manifest(Strict):
    schema_: Annotated[int, Field(alias="schema")]
    files: dict[str, _Fingerprint] = Field(description="By path in the folder.")


def fingerprint(path: Path) -> Fingerprint:
    """What a manifest says of a file."""
    data = path.read_bytes()
    return {"bytes": len(data), "sha256": hashlib.sha256(data).hexdigest()}


def write_manifest(
    folder: Path, *, schema: int, known: Mapping[str, Fingerprint] | None = None
) -> None:
    """Write manifest.json, or replace it."""
    found = dict(known or {})
    for name, kind in _entries(folder):
        if kind == "file" and name != MANIFEST and name not in found:
            found[name] = fingerprint(folder / name)
    content = {"schema": schema, "files": dict(sorted(found.items()))}
    write_text(folder / MANIFEST, json.dumps(content, indent=1) + "\n", replace=True)


def read_manifest(folder: Path, *, remedy: str) -> dict[str, Fingerprint]:
    """The files that manifest.json lists.

    Raises:
        InputError: the manifest is damaged.
        FileNotFoundError: there is none.
    """
    path = folder / MANIFEST
    with in_file(path):
        content = object_in(read_text(path, most_bytes=_MAX_MANIFEST_BYTES))
        check_schema(content.get("schema"), HISTORY, remedy=remedy)
        found = validated(_Manifest, content, remedy=remedy)
    return {name: known.model_dump() for name, known in found.files.items()}


def differences(folder: Path, listed: Mapping[str, Fingerprint]) -> Iterator[str]:
    """What is missing, changed or unexpected in a folder; links are not followed."""
    found = dict(_entries(folder))
    for name, kind in sorted(found.items()):
        if kind != "file":
            yield f"{name} is {kind}, which eyespot does not write"
        elif name != MANIFEST and name not in listed:
            yield f"{name} is not in {MANIFEST}"
    yield from changes(folder, {k: v for k, v in listed.items() if found.get(k, "file") == "file"})


def changes(folder: Path, listed: Mapping[str, Fingerprint]) -> Iterator[str]:
    """What is missing or changed of the files that a manifest lists."""
    for name, known in listed.items():
        path = inside(folder, name)
        if not path.is_file():
            yield f"{name} is missing, though {MANIFEST} lists it"
        elif fingerprint(path) != known:
            yield f"{name} differs from its checksum in {MANIFEST}"


_Kind = Literal["file", "a link", "an empty folder", "a device, socket or pipe"]


def _entries(folder: Path, above: str = "") -> Iterator[tuple[str, _Kind]]:
    """Every file in a folder, by its name, and everything else that is no folder with files."""
    with os.scandir(folder) as entries:
        for entry in entries:
            name = above + entry.name
            if entry.is_symlink():
                yield name, "a link"
            elif entry.is_file():
                yield name, "file"
            elif entry.is_dir():
                inside = list(_entries(folder / entry.name, f"{name}/"))
                yield from inside or [(name, "an empty folder")]
            else:
                yield name, "a device, socket or pipe"
