"""Writes the manifest of a set, and verifies a set against it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from benchmarks.sets.read.labelled_set import SCHEMA, LabelledSet, SetError, read_set
from estimator.files import (
    MANIFEST,
    differences,
    fingerprint,
    read_manifest,
    write_manifest,
)
from optics import InputError

_NAMED = 20  # problems listed in a message; an incomplete copy has thousands
_AGAIN = "Run `eyespot dataset` with its spec and this folder again."


def write_set_manifest(labelled: LabelledSet) -> None:
    """Write a list of all files of a set; files of a stack are taken from the stack's manifest."""
    known: dict[str, Any] = {}
    for stack in labelled.stacks:
        listed = read_manifest(stack.folder, remedy="Render the stack again.")
        listed[MANIFEST] = fingerprint(stack.folder / MANIFEST)
        known |= {f"{stack.split}/{stack.name}/{name}": file for name, file in listed.items()}
    write_manifest(labelled.folder, schema=SCHEMA, known=known)


def verify_set(folder: Path) -> int:
    """Verify that a set has all its files unchanged, and nothing else.

    Returns:
        Number of files.

    Raises:
        SetError: something is missing, changed or unexpected; the message lists it.
    """
    labelled = read_set(folder)
    if missing := [f"{stack.split}/{stack.name}" for stack in labelled.missing]:
        raise SetError(_listed(folder, [f"stack {name} is missing" for name in missing]))
    try:
        files = read_manifest(labelled.folder, remedy="Copy the set again.")
    except FileNotFoundError as error:
        raise SetError(f"{folder} is incomplete: {MANIFEST} is missing. {_AGAIN}") from error
    except InputError as error:
        raise SetError(f"{error}") from error
    if problems := list(differences(labelled.folder, files)):
        raise SetError(_listed(folder, problems))
    return len(files)


def _listed(folder: Path, problems: Sequence[str]) -> str:
    more = len(problems) - _NAMED
    lines = [f"{folder}: {problem}" for problem in problems[:_NAMED]]
    return "\n".join(lines + ([f"{folder}: and {more} more"] if more > 0 else []))
