"""The free constants of the entries: chosen on train splits, kept in a file."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from benchmarks.reporting import write_json
from optics import InputError, in_file, read_text

CONSTANTS = Path(__file__).with_name("constants.json")
"""The file that comes with eyespot."""

SCHEMA = 1

Constants = dict[str, dict[str, Any]]
"""Constants by name, by entry."""


def read_constants(path: Path = CONSTANTS) -> Constants:
    """The constants of a file that `eyespot rivals tune` wrote.

    Raises:
        InputError: no such file.
    """
    with in_file(path):
        try:
            entries = json.loads(read_text(path))["entries"]
            return {name: dict(found["constants"]) for name, found in entries.items()}
        except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
            raise InputError(f"not a file of `eyespot rivals tune` ({error}).") from error


def write_constants(path: Path, entries: dict[str, Any], origin: dict[str, Any]) -> None:
    """Write constants with their origin: the command, the set, the frames, the versions."""
    write_json(path, {"schema": SCHEMA, **origin, "entries": entries})
