"""Tables and sentences on the terminal, processor times, and memory."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from pathlib import Path

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
