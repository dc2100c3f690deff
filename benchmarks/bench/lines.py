"""Measurements as lines of a file.

What the file has is not measured again, so that a stopped run goes on. Several processes may add
lines to one file.
"""

from __future__ import annotations

import fcntl
import json
from pathlib import Path
from typing import Any


def lines_in(file: Path) -> list[dict[str, Any]]:
    """The whole lines of a file; none if it does not exist."""
    found = []
    for line in file.read_text().splitlines() if file.exists() else ():
        try:
            found.append(json.loads(line))
        except json.JSONDecodeError:  # a kill cut it off, or it is empty
            continue
    return found


def add_line(file: Path, line: dict[str, Any]) -> None:
    """Add a line, alone among the processes that share the file."""
    with file.open("a") as out:
        fcntl.flock(out, fcntl.LOCK_EX)
        out.write(f"\n{json.dumps(line)}\n")  # what a kill cut off ends first
