"""Tables and sentences on the terminal, processor times, memory, and measurements as lines.

A stopped run goes on from the lines of its file: what the file has is not measured again. Several
processes may add lines to one file.
"""

from __future__ import annotations

import fcntl
import json
import os
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console, RenderableType
from rich.table import Table


def show(*parts: RenderableType, width: int | None = None) -> None:
    """Print tables and sentences, one below the other.

    Args:
        width: columns of the output (default: those of the terminal).
    """
    console = Console(width=width, highlight=False)
    for part in parts:
        console.print(part)


def table(title: str, *headings: str, caption: str | None = None) -> Table:
    """A table whose first column is aligned left and the others right."""
    made = Table(title=title, caption=caption)
    for number, heading in enumerate(headings):
        made.add_column(heading, justify="right" if number else "left")
    return made


def rows_table(
    title: str, rows: Sequence[Mapping[str, object]], *, caption: str | None = None
) -> Table:
    """A table of rows whose keys are its headings."""
    made = table(title, *rows[0], caption=caption)
    for row in rows:
        made.add_row(*map(str, row.values()))
    return made


def processor_seconds(step: Callable[[], object], *, repeats: int = 10) -> float:
    """Median processor time of a step, s, after one call that compiles."""
    step()
    seconds = []
    for _ in range(repeats):
        began = time.process_time()
        step()
        seconds.append(time.process_time() - began)
    return float(np.median(seconds))


def memory_mb(process: int | None = None) -> float:
    """Resident memory of a process (default: this one), MB."""
    pages = int(Path(f"/proc/{process or 'self'}/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


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
