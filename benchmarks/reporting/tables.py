"""Tables of the report and CSV files."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple, get_type_hints

from benchmarks.reporting.typeset import number


class Column(NamedTuple):
    """How a column of a table is shown.

    A row type declares its columns: `k: Annotated[float, Column("k", digits=1)]`.

    Attributes:
        heading: with the unit.
        digits: decimals of floats.
        scale: factor from the value to the heading's unit.
        sign: whether positive numbers have a sign.
    """

    heading: str
    digits: int = 3
    scale: float = 1.0
    sign: bool = False

    def cell(self, value: Any) -> str:
        """The value as text: texts and integers unchanged, floats rounded."""
        if isinstance(value, str | int):
            return str(value)
        return number(value * self.scale, self.digits, sign=self.sign)


class Table(NamedTuple):
    """A table of the report.

    Attributes:
        columns: how each is shown.
        rows: values, as many as there are columns.
        caption: description.
        data: CSV file with the data.
    """

    columns: Sequence[Column]
    rows: Sequence[Sequence[Any]]
    caption: str
    data: str = ""

    @classmethod
    def of(cls, row_type: type[Any], rows: Iterable[Any], caption: str, *, data: str = "") -> Table:
        """The fields of a row type that are annotated with a `Column`."""
        shown = {
            name: column
            for name, hint in get_type_hints(row_type, include_extras=True).items()
            for column in getattr(hint, "__metadata__", ())
            if isinstance(column, Column)
        }
        cells = [[getattr(row, name) for name in shown] for row in rows]
        return cls(list(shown.values()), cells, caption, data)

    @property
    def cells(self) -> list[list[str]]:
        """The rows as texts."""
        return [
            [column.cell(value) for column, value in zip(self.columns, row, strict=True)]
            for row in self.rows
        ]

    @property
    def alignments(self) -> list[str]:
        """Class of each column's cells: numbers are aligned to the right."""
        values = [[row[n] for row in self.rows] for n in range(len(self.columns))]
        return ["" if all(isinstance(v, str) for v in column) else "n" for column in values]


def write_csv(path: Path, row_type: type[Any], rows: Iterable[Any]) -> None:
    """Write named tuples with a header line; NaN is an empty cell."""
    with path.open("w", newline="", encoding="utf-8", errors="backslashreplace") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(row_type._fields)
        writer.writerows([_csv_cell(value) for value in row] for row in rows)


def _csv_cell(value: object) -> object:
    return "" if isinstance(value, float) and math.isnan(value) else value
