"""The spots file: CSV or Parquet, one line per frame with the spot and its distance.

Missing values are empty cells (CSV) or nulls (Parquet). `schema_version` is a column, the last one,
so that any reader of tables can read the file.
"""

from __future__ import annotations

import csv
import importlib
import io
import math
from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from estimator.files.whole_files import damage_reported, written_whole
from estimator.image import PARAMETERS, NoSpot, Reason, Spot
from optics import InputError

SCHEMA_VERSION = 1

_UPPER = [(i, j) for i in range(5) for j in range(i, 5)]
_VALUES = (
    "x_px",
    "y_px",
    "semi_major_px",
    "semi_minor_px",
    "angle_rad",
    "sigma_semi_minor_px",
    "edge_width_px",
    "coverage",
    "inlier_fraction",
    "saturated",
)
_DISTANCES = ("distance_mm", "sigma_distance_mm", "pose_age_s")
_COVARIANCES = tuple(f"cov_{PARAMETERS[i]}_{PARAMETERS[j]}" for i, j in _UPPER)
COLUMNS = (
    "frame",
    "file_name",
    "time_s",
    "mode",
    "status",
    "reason",
    *_VALUES,
    *_DISTANCES,
    *_COVARIANCES,
    "schema_version",
)
_KINDS: dict[str, type] = {
    **dict.fromkeys(("frame", "schema_version"), int),
    **dict.fromkeys(("file_name", "mode", "status", "reason"), str),
}
"""Type of a Parquet column; the others are floats."""


@dataclass(frozen=True, kw_only=True)
class SpotRecord:
    """One line of a spots file.

    Attributes:
        frame: index of the frame.
        file_name: of the frame's image; empty if there is none.
        time_s: of the frame; NaN if unknown.
        mode: "literal" or "subpixel".
        result: the spot, or why there is none.
        distance_mm: from the tip to the wall along the beam; NaN without a calibration.
        sigma_distance_mm: its standard deviation.
        pose_age_s: age of the robot's pose at the frame's time; NaN if unknown.
    """

    frame: int
    file_name: str
    time_s: float
    mode: str
    result: Spot | NoSpot
    distance_mm: float = field(default=math.nan)
    sigma_distance_mm: float = field(default=math.nan)
    pose_age_s: float = field(default=math.nan)

    @property
    def status(self) -> str:
        """The file's `status`: "spot" or "no_spot"."""
        return "spot" if self.result else "no_spot"

    @property
    def reason(self) -> str:
        """The file's `reason`: one of `Reason`, empty with a spot."""
        return self.result.reason.value if isinstance(self.result, NoSpot) else ""


def write_spots(path: str | Path, records: Iterable[SpotRecord]) -> None:
    """Write a spots file, whole or not at all; one of the same name is replaced.

    Args:
        path: of the file; the suffix `.parquet` selects Parquet, any other CSV.
        records: in the order of the file's lines.

    Raises:
        InputError: Parquet without pyarrow installed.
    """
    write = _write_parquet if is_parquet(path) else _write_csv
    with written_whole(Path(path), replace=True) as partial:
        write(partial, records)


def read_spots(path: str | Path) -> list[SpotRecord]:
    """Read a spots file.

    Raises:
        InputError: not a spots file, of another schema version, or with a wrong value; the message
            names the file and the line.
    """
    rows = _parquet_rows(Path(path)) if is_parquet(path) else _csv_rows(Path(path))
    return [_record(row, where) for row, where in rows]


def pyarrow() -> Any:
    """The library that reads and writes Parquet, loaded when it is needed.

    Raises:
        InputError: it is not installed.
    """
    try:
        importlib.import_module("pyarrow.parquet")
    except ModuleNotFoundError as error:
        raise InputError(
            "Parquet needs the package pyarrow: pip install 'eyespot[parquet]'. CSV needs nothing."
        ) from error
    return importlib.import_module("pyarrow")


def is_parquet(path: str | Path) -> bool:
    """Whether a spots file of this name is Parquet, and not CSV."""
    return Path(path).suffix.lower() == ".parquet"


def csv_line(record: SpotRecord | None) -> str:
    """The line of a record in a CSV file; without a record, the line of the column names."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerow(_line(record) if record else COLUMNS)
    return text.getvalue()


def parquet_of_csv(lines: Path, path: Path) -> None:
    """Write the Parquet file with the lines of a CSV file, a part at a time.

    Args:
        lines: spots file, CSV.
        path: of the Parquet file.
    """
    pa, csv_reader = pyarrow(), importlib.import_module("pyarrow.csv")
    kinds = {int: pa.int64(), str: pa.string(), float: pa.float64()}
    schema = pa.schema([(name, kinds[_KINDS.get(name, float)]) for name in COLUMNS])
    # Only numbers may be missing, and only as empty cells: NA may be the name of a file.
    convert = csv_reader.ConvertOptions(column_types=schema, null_values=[""])
    parse = csv_reader.ParseOptions(newlines_in_values=True)
    with (
        csv_reader.open_csv(lines, convert_options=convert, parse_options=parse) as parts,
        pa.parquet.ParquetWriter(path, schema) as file,
    ):
        for part in parts:
            file.write_batch(part)


def _write_csv(path: Path, records: Iterable[SpotRecord]) -> None:
    with path.open("w", encoding="utf-8", newline="") as file:
        file.write(csv_line(None))
        file.writelines(map(csv_line, records))


def _csv_rows(path: Path) -> Iterator[tuple[dict[str, str], str]]:
    with path.open(newline="", encoding="utf-8") as file:
        try:
            rows = csv.DictReader(file, strict=True)
            _check_columns(rows.fieldnames or (), f"{path}, line 1")
            for row in rows:
                yield row, f"{path}, line {rows.line_num}"
        except (csv.Error, UnicodeDecodeError) as error:
            raise InputError(f"{path}: not a spots file: {error}.") from error


def _write_parquet(path: Path, records: Iterable[SpotRecord]) -> None:
    lines = path.with_name("lines.csv")
    _write_csv(lines, records)
    parquet_of_csv(lines, path)


def _parquet_rows(path: Path) -> Iterator[tuple[dict[str, str], str]]:
    pa = pyarrow()
    with path.open("rb") as file, damage_reported(f"{path}", "Write it with write_spots."):
        table = pa.parquet.read_table(file)
    _check_columns(table.column_names, f"{path}")
    for index, row in enumerate(table.to_pylist()):
        cells = {name: "" if value is None else str(value) for name, value in row.items()}
        yield cells, f"{path}, row {index}"


def _check_columns(names: Collection[str], where: str) -> None:
    missing = [name for name in COLUMNS if name not in names]
    if missing:
        raise InputError(
            f"{where}: not a spots file: column {missing[0]!r} is missing"
            f" ({len(missing)} of {len(COLUMNS)} are). Write it with write_spots."
        )


def _line(record: SpotRecord) -> list[str]:
    spot = record.result if isinstance(record.result, Spot) else None
    values = [getattr(spot, name) for name in _VALUES] if spot else [math.nan] * len(_VALUES)
    covariance = [spot.covariance[i, j] if spot else math.nan for i, j in _UPPER]
    return [
        str(record.frame),
        record.file_name,
        _cell(record.time_s),
        record.mode,
        record.status,
        record.reason,
        *map(_cell, values),
        *(_cell(getattr(record, name)) for name in _DISTANCES),
        *map(_cell, covariance),
        str(SCHEMA_VERSION),
    ]


def _cell(value: float) -> str:
    return "" if math.isnan(value) else repr(float(value))


def _record(row: dict[str, str], where: str) -> SpotRecord:
    if None in row or None in row.values():
        raise InputError(f"{where}: {len(COLUMNS)} cells expected, as in the header.")
    if row["schema_version"] != str(SCHEMA_VERSION):
        raise InputError(
            f"{where}: schema_version is {row['schema_version']!r}; this software reads"
            f" {SCHEMA_VERSION}. Write the file again with this version."
        )
    values = {
        name: _number(row, name, where) for name in ("time_s", *_VALUES, *_DISTANCES, *_COVARIANCES)
    }
    try:
        frame = int(row["frame"])
    except ValueError:
        raise InputError(f"{where}: frame must be a whole number; got {row['frame']!r}.") from None
    return SpotRecord(
        frame=frame,
        file_name=row["file_name"],
        time_s=values["time_s"],
        mode=row["mode"],
        result=_result(row, values, where),
        **{name: values[name] for name in _DISTANCES},
    )


def _number(row: dict[str, str], name: str, where: str) -> float:
    cell = row[name]
    try:
        return float(cell) if cell else math.nan
    except ValueError:
        raise InputError(f"{where}: {name} must be a number or empty; got {cell!r}.") from None


def _result(row: dict[str, str], values: dict[str, float], where: str) -> Spot | NoSpot:
    if row["status"] == "no_spot":
        try:
            return NoSpot(Reason(row["reason"]))
        except ValueError:
            known = ", ".join(reason.value for reason in Reason)
            raise InputError(
                f"{where}: reason must be one of {known}; got {row['reason']!r}."
            ) from None
    if row["status"] != "spot":
        raise InputError(f"{where}: status must be spot or no_spot; got {row['status']!r}.")
    covariance = np.empty((5, 5))
    for (i, j), name in zip(_UPPER, _COVARIANCES, strict=True):
        covariance[i, j] = covariance[j, i] = values[name]
    measured = {name: values[name] for name in _VALUES if name != "sigma_semi_minor_px"}
    return Spot(covariance=covariance, **measured)
