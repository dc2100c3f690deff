"""The spots file: CSV or Parquet, one line per frame.

Missing values are empty cells (CSV) or nulls (Parquet). `schema_version` is a column, the last one,
so that any reader of tables can read the file.
"""

import csv
import io
import itertools
import math
import re
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, NamedTuple

import numpy as np
from pydantic import Field, create_model
from pydantic import Strict as StrictType

from eyespot.formats.calibration import check_covariance
from eyespot.formats.inputs import (
    MOST_ROWS,
    InputError,
    Strict,
    check_regular,
    check_schema,
    csv_rows,
    in_file,
    number_in,
    validated,
)
from eyespot.formats.spot import PARAMETERS, NoSpot, OwnHalf, Reason, Spot
from eyespot.formats.whole_files import (
    append_line,
    damage_reported,
    give_name,
    refuse_existing,
    refuse_foreign,
    written_whole,
)

if TYPE_CHECKING:
    import pandas as pd


SCHEMA_VERSION = 6
HISTORY = {
    1: "the format of eyespot 0.1; files written since may have the reason internal_error "
    "or unreadable",
    2: "distance_low_mm, distance_high_mm and largest_cause: the distance's 95 % interval, and "
    "what makes it wide; tip, axis, their covariance, chi_squared and wall_memory of the mode "
    "pixels",
    3: "significance of a spot that is too_faint",
    4: "reason of a spot without a distance, or with a doubtful one; mode of each frame",
    5: "measured_with, the versions of eyespot and OpenCV; surface_distance_mm",
    6: "own_right_px to own_less_growth_variance: where each side's light is half of its own",
}

_MOST_FRAMES = 2**31
_LARGEST_PX = 1e6
_ROUNDING = 1e-6
"""Relative: how far two values of one fact may differ."""
_UNIT_LENGTH_TOLERANCE = 1e-3
"""Of a unit vector's length, as people round it."""

_UPPER = np.triu_indices(5)
_ELLIPSE = ("x_px", "y_px", "semi_major_px", "semi_minor_px", "angle_rad")
_OWN_HALF = tuple(f"own_{name}" for name in OwnHalf._fields)
_QUALITY = ("edge_width_px", "coverage", "inlier_fraction", "saturated")
_DISTANCES = ("distance_mm", "sigma_distance_mm", "pose_age_s")
_INTERVAL = ("distance_low_mm", "distance_high_mm")
_POSE = tuple(f"{part}_{x}{unit}" for part, unit in (("tip", "_mm"), ("axis", "")) for x in "xyz")
_POSE_COVARIANCES = tuple(f"pose_cov_{i}_{j}" for i, j in zip(*_UPPER, strict=True))
_COVARIANCES = tuple(f"cov_{PARAMETERS[i]}_{PARAMETERS[j]}" for i, j in zip(*_UPPER, strict=True))


def _numbers(names: Iterable[str], meaning: str | None = None, **limits: Any) -> dict[str, Any]:
    """Columns of numbers, whose empty cells are NaN."""
    field: Any = Field(math.nan, description=meaning, **limits)
    return {name: (float, field) for name in names}


_MEASURED: dict[str, Any] = {
    **_numbers(_ELLIPSE[:2], gt=-_LARGEST_PX, lt=_LARGEST_PX),
    **_numbers(_ELLIPSE[2:4], gt=0, lt=_LARGEST_PX),
    **_numbers(_ELLIPSE[4:]),
    **_numbers(["sigma_semi_minor_px"], "Of the semi-minor axis.", ge=0, le=_LARGEST_PX),
    **_numbers(_QUALITY[:1], ge=0, le=_LARGEST_PX),
    **_numbers(_QUALITY[1:], ge=0, le=1 + _ROUNDING),
}
_POSE_NUMBERS = {
    **_numbers(_POSE[:3], "Mode pixels: the tip in the eye frame."),
    **_numbers(_POSE[3:], "Mode pixels: unit vector of the beam in the eye frame."),
    **_numbers(_POSE_COVARIANCES, "Mode pixels: of the tip (mm) and the axis's two turns (rad)."),
    **_numbers(["chi_squared"], "Mode pixels: per cell; 1 where all light is explained."),
}
_STATUS: Any = Literal["spot", "no_spot"]
SpotRow = create_model(
    "SpotRow",
    __base__=Strict,
    __doc__="A row of a spots file, without its empty cells.",
    frame=(Annotated[int, Field(ge=0, lt=_MOST_FRAMES)], ...),
    file_name=(str, ""),
    **_numbers(["time_s"]),
    mode=(str, ""),
    status=(_STATUS, Field(description="Whether there is a spot.")),
    reason=(
        Annotated[Reason, StrictType(False)],
        Field(None, description="Why there is no spot, no distance or a doubtful one."),
    ),
    **_MEASURED,
    **_numbers(_DISTANCES[:1]),
    **_numbers(_DISTANCES[1:2], ge=0, le=1e9),
    **_numbers(_DISTANCES[2:]),
    **_numbers(_COVARIANCES, "Covariance of two of the ellipse's parameters, px and rad."),
    **_numbers((*_INTERVAL, "surface_distance_mm")),
    largest_cause=(str, ""),
    **_POSE_NUMBERS,
    wall_memory=(str, ""),
    **_numbers(["significance"], "Of a spot that is too_faint: peak over scatter."),
    measured_with=(str, ""),
    **_numbers(_OWN_HALF[:2], "To the contour where each side's light is half of its own."),
    **_numbers(_OWN_HALF[2:3], "The same: ratio of the axes.", gt=0),
    **_numbers(_OWN_HALF[3:4], "The same: more variance of the centre's coordinates."),
    **_numbers(_OWN_HALF[4:], "The same: less relative variance of the axes.", ge=0),
    schema_version=(int, Field(description="Version of the format.")),
)
COLUMNS = tuple(SpotRow.model_fields)
_LATER = COLUMNS[COLUMNS.index(_INTERVAL[0]) : -1]
"""Columns that files of version 1 do not have."""
_KINDS: dict[str, Any] = {
    name: field.annotation if field.annotation in (int, float) else str
    for name, field in SpotRow.model_fields.items()
}
"""Type of each column as it is written."""


class RecordedPose(NamedTuple):
    """Tip and axis of the beam in the eye frame.

    Attributes:
        tip_mm: S, (3,).
        axis: unit vector from the tip towards the wall, (3,).
        covariance: 5 x 5, of the tip (mm) and of the axis's turns (rad) towards two unit vectors:
            the axis cross the coordinate axis that is farthest from it, and the axis cross that.
        chi_squared: per cell; 1 where beam, wall and camera explain the light.
    """

    tip_mm: np.ndarray
    axis: np.ndarray
    covariance: np.ndarray
    chi_squared: float


@dataclass(frozen=True, kw_only=True)
class SpotRecord:
    """One line of a spots file.

    Attributes:
        frame: index of the frame.
        file_name: of the frame's image; empty if there is none.
        time_s: of the frame; NaN if unknown.
        mode: that measured the frame: "literal", "subpixel" or "pixels".
        result: the spot, or why there is none.
        distance_mm: from the tip to the wall along the beam; NaN without a calibration. The mode
            pixels may know it without a spot.
        sigma_distance_mm: its standard deviation.
        pose_age_s: age of the robot's pose at the frame's time; NaN if unknown.
        distance_low_mm: begin of the 95 % interval of the distance, which contains the model's
            correction, if there is one; NaN if unknown, as in files of version 1.
        distance_high_mm: its end.
        surface_distance_mm: the distance less the clear layer over the reflecting wall, along the
            beam: to what a tool would touch; NaN if unknown.
        largest_cause: what makes it wide: one of `Cause`; empty if unknown.
        pose: tip and axis of the mode pixels; None of the others.
        wall_memory: what the mode pixels knew of the wall: one of `WallMemory`; empty in the
            others.
        doubt: why a spot has no distance or a doubtful one: one of `Reason`; empty if all is well,
            or without a calibration.
        measured_with: versions of what measured the frame, eyespot and OpenCV: two of OpenCV may
            differ by 0.004 px. Empty if unknown, as in files up to version 4.
    """

    frame: int
    file_name: str
    time_s: float
    mode: str
    result: Spot | NoSpot
    distance_mm: float = field(default=math.nan)
    sigma_distance_mm: float = field(default=math.nan)
    pose_age_s: float = field(default=math.nan)
    distance_low_mm: float = field(default=math.nan)
    distance_high_mm: float = field(default=math.nan)
    surface_distance_mm: float = field(default=math.nan)
    largest_cause: str = ""
    pose: RecordedPose | None = None
    wall_memory: str = ""
    doubt: str = ""
    measured_with: str = ""

    @property
    def status(self) -> str:
        """The file's `status`: "spot" or "no_spot"."""
        return "spot" if self.result else "no_spot"

    @property
    def reason(self) -> str:
        """The file's `reason`: one of `Reason`; empty if all is well."""
        return self.result.reason.value if isinstance(self.result, NoSpot) else self.doubt

    @property
    def significance(self) -> float:
        """Of a spot that is too faint, see `NoSpot`; NaN of others."""
        return self.result.significance if isinstance(self.result, NoSpot) else math.nan


def write_spots(path: str | Path, records: Iterable[SpotRecord]) -> None:
    """Write a spots file, whole or not at all; one of the same name is replaced.

    Args:
        path: of the file; the suffix `.parquet` selects Parquet, any other CSV.

    Raises:
        InputError: Parquet without pyarrow installed.
    """
    with written_whole(Path(path), replace=True) as partial:
        lines = partial.with_name("lines.csv") if is_parquet(path) else partial
        with lines.open("w", encoding="utf-8", newline="") as file:
            file.writelines(map(_csv_line, itertools.chain([COLUMNS], map(_cells, records))))
        if is_parquet(path):
            _parquet_of_csv(lines, partial)


@contextmanager
def spots_stream(path: Path, *, replace: bool = False) -> Iterator[Callable[[SpotRecord], None]]:
    """Write a spots file record by record; it gets its name when the block ends, also by an error.

    Until then its lines are in a CSV file beside it, `NAME.partial.csv`. It is left behind only by
    a process that is killed, then with a whole line for each record that was written, and by one
    that cannot make the spots file of it. A run that finds one is refused, because its lines may be
    the only ones.

    Args:
        replace: whether it may exist; it is then replaced at the end.

    Yields:
        A function that writes a record. It raises OSError if the disk is full; the lines before
        stay.

    Raises:
        InputError: the file or a partial one exists, or Parquet without pyarrow installed.
        OSError: nothing can be written there.
    """
    if is_parquet(path):
        _pyarrow()
    (refuse_foreign if replace else refuse_existing)(path)
    partial = path.with_name(f"{path.stem}.partial.csv")
    try:
        file = partial.open("xb", buffering=0)
    except FileExistsError as error:
        raise InputError(
            f"{partial} exists: a run into {path.name} was killed and left there what it had"
            " measured, or is still writing it. Rename it to keep it, or remove it."
        ) from error
    written = 0

    def append(cells: Iterable[object]) -> None:
        try:
            append_line(file, _csv_line(cells))
        except OSError as error:
            raise OSError(error.errno, error.strerror, f"{path}") from error

    def write(record: SpotRecord) -> None:
        nonlocal written
        append(_cells(record))
        written += 1

    try:
        with file:
            append(COLUMNS)
            yield write
    finally:
        if written:
            _finish(partial, path, replace=replace)
        else:
            partial.unlink()


def _finish(partial: Path, path: Path, *, replace: bool) -> None:
    """Make the spots file of the partial one."""
    kept = f"What was measured is in {partial}"
    try:
        if is_parquet(path):
            with written_whole(path, replace=replace) as whole:
                _parquet_of_csv(partial, whole)
        else:
            give_name(partial, path, replace=replace)
    except InputError as error:
        raise InputError(f"{error} {kept}.") from error
    except OSError as error:
        raise OSError(error.errno, f"{error.strerror}. {kept}", f"{path}") from error
    partial.unlink(missing_ok=True)


def spots_table(records: Iterable[SpotRecord]) -> "pd.DataFrame":
    """The records as a table with a spots file's columns; those that people read come first."""
    import pandas as pd

    table = pd.DataFrame(map(_cells, records), columns=[*COLUMNS])
    table = table.astype({name: kind for name, kind in _KINDS.items() if kind is not str})
    first = ["frame", "file_name", "time_s", "distance_mm", *_INTERVAL, *_ELLIPSE, "reason"]
    return table[[*first, *table.columns.drop(first)]]


def read_spots(path: str | Path) -> list[SpotRecord]:
    """Read a spots file.

    Raises:
        InputError: not a spots file, of another schema version, or with a wrong value; the message
            names the file and the line.
    """
    path = Path(path)
    rows = _parquet_rows(path) if is_parquet(path) else csv_rows(path, check=_check_columns)
    records = []
    for row, where in rows:
        with in_file(where):
            records.append(_record(row))
    return records


def _pyarrow() -> Any:
    """The library that reads and writes Parquet, loaded when it is needed.

    Raises:
        InputError: it is not installed.
    """
    try:
        import pyarrow.csv
        import pyarrow.parquet
    except ModuleNotFoundError as error:
        raise InputError(
            "Parquet needs the package pyarrow: pip install 'eyespot[parquet]'. CSV needs nothing."
        ) from error
    return pyarrow


def is_parquet(path: str | Path) -> bool:
    """Whether a spots file of this name is Parquet, and not CSV."""
    return Path(path).suffix.lower() == ".parquet"


def _cells(record: SpotRecord) -> list[Any]:
    """A record's value in each column; what it does not have is NaN."""
    spot, pose = record.result, record.pose
    values: dict[str, Any] = {"schema_version": SCHEMA_VERSION}
    if isinstance(spot, Spot):
        values |= {name: getattr(spot, name) for name in _MEASURED}
        values |= zip(_COVARIANCES, spot.covariance[_UPPER], strict=True)
        values |= zip(_OWN_HALF, spot.own_half, strict=True)
    if pose is not None:
        of_pose = *pose.tip_mm, *pose.axis, *pose.covariance[_UPPER], pose.chi_squared
        values |= zip(_POSE_NUMBERS, of_pose, strict=True)
    return [_KINDS[name](values.get(name, getattr(record, name, math.nan))) for name in COLUMNS]


def _csv_line(cells: Iterable[object]) -> str:
    """A line of a CSV file, in which NaN is an empty cell."""
    text = io.StringIO()
    known = ("" if isinstance(cell, float) and math.isnan(cell) else cell for cell in cells)
    csv.writer(text, lineterminator="\n").writerow(known)
    return text.getvalue()


def _parquet_of_csv(lines: Path, path: Path) -> None:
    """Write the Parquet file with the lines of a CSV file, a part at a time."""
    pa = _pyarrow()
    kinds = {int: pa.int64(), str: pa.string(), float: pa.float64()}
    schema = pa.schema([(name, kinds[_KINDS[name]]) for name in COLUMNS])
    # Only numbers may be missing, and only as empty cells: NA may be the name of a file.
    convert = pa.csv.ConvertOptions(column_types=schema, null_values=[""])
    parse = pa.csv.ParseOptions(newlines_in_values=True)
    # As open files: pyarrow takes no names that are not UTF-8.
    with (
        lines.open("rb") as source,
        path.open("wb") as sink,
        pa.csv.open_csv(source, convert_options=convert, parse_options=parse) as parts,
        pa.parquet.ParquetWriter(sink, schema) as file,
    ):
        for part in parts:
            file.write_batch(part)


def _parquet_rows(path: Path) -> Iterator[tuple[dict[str, str], str]]:
    pa = _pyarrow()
    again = "Write it with write_spots."
    with in_file(path):
        check_regular(path)
    with path.open("rb") as opened:
        with damage_reported(f"{path}", again):
            file = pa.parquet.ParquetFile(opened)
            names, count = file.schema_arrow.names, file.metadata.num_rows
        with in_file(path):
            _check_columns(names)
            if count > MOST_ROWS:
                raise InputError(f"{count:,} rows; at most {MOST_ROWS:,} are read. Split the file.")
        with damage_reported(f"{path}", again):
            rows = file.read(columns=[n for n in COLUMNS if n in names]).to_pylist()
    for index, row in enumerate(rows):
        cells = {name: "" if value is None else str(value) for name, value in row.items()}
        yield cells, f"{path}, row {index}"


def _check_columns(names: Collection[str]) -> None:
    missing = [name for name in COLUMNS if name not in names and name not in _LATER]
    if missing:
        raise InputError(
            f"not a spots file: column {missing[0]!r} is missing"
            f" ({len(missing)} of {len(COLUMNS)} are). Write it with write_spots."
        )


def _covariance(cells: Any, names: Sequence[str]) -> np.ndarray:
    """The symmetric matrix with these values at and above its diagonal; NaN if it is unknown.

    Raises:
        InputError: no covariance has these values.
    """
    upper = np.zeros((5, 5))
    upper[_UPPER] = [getattr(cells, name) for name in names]
    matrix = upper + np.triu(upper, 1).T
    if np.isnan(matrix).any():
        return matrix
    with in_file(names[0]):
        check_covariance(matrix, most=_LARGEST_PX**2)
    return matrix


def folded_angle(angle_rad: float) -> float:
    """An ellipse's angle in (-pi/2, pi/2], where every half turn gives the same ellipse.

    Raises:
        InputError: more than a turn, which is likely to be in degrees.
    """
    if not abs(angle_rad) <= 2 * math.pi + _ROUNDING:
        raise InputError(
            f"angle_rad must lie within a turn, 2 pi; got {angle_rad:g} rad. Write radians, not "
            "degrees."
        )
    if -math.pi / 2 < angle_rad <= math.pi / 2:
        return angle_rad
    return math.pi / 2 - (math.pi / 2 - angle_rad) % math.pi


def _record(row: dict[str, str]) -> SpotRecord:
    version = row["schema_version"]
    found = int(version) if re.fullmatch("[0-9]{1,9}", version) else version or None
    check_schema(found, HISTORY, remedy="Write the file again.")
    values: dict[str, Any] = {}
    for name, kind in _KINDS.items():
        if cell := row.get(name, ""):
            values[name] = cell if kind is str else number_in(cell, name)
            if kind is int and values[name] % 1 == 0:
                values[name] = int(values[name])
    known = {name: value for name, value in values.items() if value == value}  # NaN is not
    cells: Any = validated(SpotRow, known, remedy="Write the spots again.")
    if cells.distance_low_mm > cells.distance_high_mm:
        raise InputError(
            "distance_low_mm must not exceed distance_high_mm; got "
            f"{cells.distance_low_mm:g} and {cells.distance_high_mm:g} mm."
        )
    pose = None
    if not math.isnan(cells.tip_x_mm):
        place = np.array([getattr(cells, name) for name in _POSE])
        if not abs(np.linalg.norm(place[3:]) - 1) < _UNIT_LENGTH_TOLERANCE:
            raise InputError(f"axis must be a unit vector; got {place[3:].tolist()}.")
        covariance = _covariance(cells, _POSE_COVARIANCES)
        pose = RecordedPose(place[:3], place[3:], covariance, cells.chi_squared)
    of_record = {f.name for f in fields(SpotRecord)} & {*COLUMNS}
    return SpotRecord(
        **{name: getattr(cells, name) for name in of_record},
        result=_result(cells),
        pose=pose,
        doubt=cells.reason.value if cells.reason else "",
    )


def _result(cells: Any) -> Spot | NoSpot:
    if cells.status == "no_spot":
        if not cells.reason:
            raise InputError("a frame without a spot needs a reason.")
        return NoSpot(cells.reason, cells.significance)
    measured = {name: getattr(cells, name) for name in (*_ELLIPSE, *_QUALITY)}
    for name in _ELLIPSE[:4]:
        if math.isnan(measured[name]):
            raise InputError(f"{name} of a spot must be a number of px; got an empty cell.")
    major, minor = cells.semi_major_px, cells.semi_minor_px
    if minor > major * (1 + _ROUNDING):
        raise InputError(
            f"semi_minor_px must not exceed semi_major_px; got {minor:g} and {major:g} px."
        )
    measured |= {"angle_rad": folded_angle(cells.angle_rad)}
    own = {name: getattr(cells, f"own_{name}") for name in OwnHalf._fields}
    measured["own_half"] = OwnHalf(**{name: own[name] for name in own if own[name] == own[name]})
    return Spot(covariance=_covariance(cells, _COVARIANCES), **measured)
