"""Tables that other software wrote: CSV files, their numbers and their times."""

import csv
import itertools
import re
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from eyespot.formats.inputs import (
    MOST_CSV_BYTES,
    MOST_ROWS,
    InputError,
    check_regular,
    in_file,
    shortened,
)

if TYPE_CHECKING:
    import pandas as pd
    from jaxtyping import Float

Place = Callable[[int], str]
"""Where a row of a table stands, for messages; rows count from 0."""

SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
"""Units of time."""
LATEST_S = 1e11
"""Clocks count from 1970; what is later than the year 5138 is in another unit."""
_DATE = re.compile(r"\s*\d{4}-\d\d-\d\d")
"""With it begins a time after ISO 8601."""
_SEPARATORS = ",;\t"
_DECIMAL_COMMA = r"^\s*([-+]?\d*),(\d+(?:[eE][-+]?\d+)?)\s*$"
"""A number as spreadsheets write it beside semicolons where the decimal sign is a comma."""
_MOST_COLUMNS = 1000


def read_table(path: Path) -> "pd.DataFrame":
    """Read a CSV file with a header; its cells are separated by commas, semicolons or tabs.

    Cells that a shorter row lacks are NaN. A column with a cell that is no number is text. Between
    semicolons, 0,5 is the number 0.5. Rows without content at the end are left out.

    Raises:
        InputError: not CSV, too large, or rows longer than the header; the message names the file.
        OSError: the file cannot be read.
    """
    import pandas as pd

    with in_file(path):
        check_regular(path, most_bytes=MOST_CSV_BYTES, remedy="Split it, or write fewer rows.")
        try:
            with warnings.catch_warnings():
                # Pandas raises if some rows are longer than the header, and warns if all are.
                warnings.simplefilter("error", pd.errors.ParserWarning)
                separator = _separator(path)
                table = pd.read_csv(
                    path,
                    sep=separator,
                    encoding="utf-8-sig",
                    index_col=False,
                    keep_default_na=False,
                    low_memory=False,
                    nrows=MOST_ROWS + 1,
                )
        except pd.errors.EmptyDataError:
            return pd.DataFrame()
        except InputError:
            raise
        except UnicodeDecodeError as error:
            raise InputError(f"not a text file: {error}. Save it as CSV in UTF-8.") from None
        except pd.errors.ParserWarning as error:
            raise InputError(
                "its rows have more cells than its header. Name every column; if numbers have "
                "decimal commas, write points, or separate the cells by semicolons."
            ) from error
        except (ValueError, OverflowError) as error:
            raise InputError(f"not a CSV file: {' '.join(f'{error}'.split())}.") from error
        if len(table) > MOST_ROWS:
            raise InputError(f"more than {MOST_ROWS:,} rows. Split the file.")
        while len(table) and (table.iloc[-1] == "").all():
            table = table.iloc[:-1]
        if separator == ";":
            for name in table.columns:
                if not pd.api.types.is_numeric_dtype(table[name]):
                    table[name] = table[name].replace(_DECIMAL_COMMA, r"\1.\2", regex=True)
        return table


def _separator(path: Path) -> str:
    with path.open(encoding="utf-8-sig") as file:
        header = file.readline()
    separator = max(_SEPARATORS, key=header.count)
    if header.count(separator) >= _MOST_COLUMNS:  # pandas takes the square of them
        raise InputError(f"more than {_MOST_COLUMNS:,} columns. Keep those that are needed.")
    return separator


def lines_of(path: Path) -> Place:
    """The places of a CSV file's rows: file and line, and what a short row lacks."""

    def place(row: int) -> str:
        with path.open(newline="", encoding="utf-8-sig") as file:
            rows = csv.reader(file, delimiter=_separator(path))
            filled = (cells for cells in rows if cells)
            try:
                header = next(filled)
                cells = next(itertools.islice(filled, row, None))
            except csv.Error:  # a cell of more than 128 kB
                return f"{path}"
            short = "" if len(cells) >= len(header) else f": {len(header)} cells expected"
            return f"{path}, line {rows.line_num}{short}"

    return place


_MAX_NUMBER = 1e300  # a larger one is infinite in other units


def numbers(column: "pd.Series[Any]", place: Place) -> "Float[np.ndarray, 'n']":
    """A column as finite numbers.

    Raises:
        InputError: a cell is no finite number; the text names its place.
    """
    import pandas as pd

    values = np.asarray(pd.to_numeric(column, errors="coerce"), dtype=float)
    for row in np.flatnonzero(~(np.abs(values) < _MAX_NUMBER))[:1]:
        cell = shortened(column.iloc[row])
        raise InputError(f"{place(row)}: {column.name} must be a finite number; got {cell}.")
    return values


def seconds(column: "pd.Series[Any]", place: Place, *, unit_s: float) -> "Float[np.ndarray, 'n']":
    """A column of times in seconds; times after ISO 8601 count from 1970, UTC if no zone is given.

    Args:
        unit_s: of times that are numbers, s.

    Raises:
        InputError: a cell is no time, or a time has another unit; the text names its place.
    """
    import pandas as pd

    if len(column) and _DATE.match(f"{column.iloc[0]}"):
        dates = pd.to_datetime(column, format="ISO8601", utc=True, errors="coerce")
        for row in np.flatnonzero(dates.isna())[:1]:
            cell = shortened(column.iloc[row])
            raise InputError(f"{place(row)}: {column.name} must be a time (ISO 8601); got {cell}.")
        return np.asarray((dates - pd.Timestamp(0, tz="UTC")).dt.total_seconds(), dtype=float)
    values = numbers(column, place) * unit_s
    for row in np.flatnonzero(np.abs(values) > LATEST_S)[:1]:
        raise InputError(
            f"{place(row)}: {column.name} must be a time in s; got {values[row]:.6g}. End the "
            f"column's name with its unit, {', '.join(f'_{unit}' for unit in SECONDS)}."
        )
    return values
