"""Reads CSV files that anyone may have written, row by row."""

from __future__ import annotations

import csv
import math
from collections.abc import Callable, Collection, Iterator
from pathlib import Path

from optics import InputError, check_regular, in_file, shortened

MOST_BYTES = 2**28
"""Largest CSV file, 256 MiB."""
MOST_ROWS = 2**20
"""Most rows, each of which takes up to 1 kB of memory: the robot's poses for 87 minutes."""


def csv_rows(
    path: Path, *, check: Callable[[Collection[str]], None]
) -> Iterator[tuple[dict[str, str], str]]:
    """The rows of a CSV file with a header, each with its place for messages.

    Args:
        path: of the file.
        check: refuses a header with an InputError.

    Raises:
        InputError: not CSV, too large, or a row of another length than the header; the message
            names file and line.
        OSError: the file cannot be read.
    """
    with in_file(path):
        size = check_regular(path)
        if size > MOST_BYTES:
            raise InputError(
                f"larger than {MOST_BYTES:,} bytes ({size:,}). Split it, or write fewer rows."
            )
    with path.open(newline="", encoding="utf-8-sig") as file:
        rows = csv.DictReader(file, strict=True)
        try:
            with in_file(f"{path}, line 1"):
                check(rows.fieldnames or ())
            for number, row in enumerate(rows):
                where = f"{path}, line {rows.line_num}"
                if None in row or None in row.values():
                    width = len(rows.fieldnames or ())
                    raise InputError(f"{where}: {width} cells expected, as in the header.")
                if number >= MOST_ROWS:
                    raise InputError(f"{path}: more than {MOST_ROWS:,} rows. Split the file.")
                yield row, where
        except csv.Error as error:
            raise InputError(f"{path}: not a CSV file: {error}.") from error
        except UnicodeDecodeError as error:
            raise InputError(f"{path}: not a text file: {error}.") from None


def number_in(cell: str, name: str) -> float:
    """The finite number in a cell; NaN in an empty one.

    Raises:
        InputError: not a number, or not finite; without the place.
    """
    try:
        value = float(cell) if cell else math.nan
    except ValueError:
        value = math.inf
    if math.isinf(value):
        raise InputError(f"{name} must be a finite number; got {shortened(cell)}.")
    return value
