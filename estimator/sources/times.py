"""When the images of a folder were taken: frames.csv beside them, EXIF, or a rate."""

from collections.abc import Sequence
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from eyespot.formats.inputs import InputError, in_file, shortened

if TYPE_CHECKING:
    import pandas as pd

TABLE = "frames.csv"
"""The table beside the images: `file,time_s,exposure_s`, in any order."""
UNITS_S = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
"""Endings of a column of times, and their seconds."""
_EXIF, _TAKEN, _FRACTION = 0x8769, 0x9003, 0x9291  # the tags DateTimeOriginal, SubSecTimeOriginal


class FrameTimes(NamedTuple):
    """Times of images, s; NaN where unknown.

    Attributes:
        time_s: middle of the exposures.
        exposure_s: exposure times.
        source: what states them; empty if nothing does.
    """

    time_s: np.ndarray
    exposure_s: np.ndarray
    source: str = ""


def times_of(pictures: Sequence[Path], *, fps: float | None = None) -> FrameTimes:
    """Times of the images of a folder, in their order.

    Args:
        pictures: of one folder.
        fps: images a second, for a folder without a table.

    Raises:
        InputError: the table does not fit the images, or a rate is given although there is one.
    """
    none = np.full(len(pictures), np.nan)
    table = pictures[0].parent / TABLE
    if table.is_file():
        if fps is not None:
            raise InputError(f"{table} has the times of the frames. Leave --fps out.")
        with in_file(table):
            return _of_table(table, [path.name for path in pictures])
    if fps is not None:
        return FrameTimes(np.arange(len(pictures)) / fps, none, f"--fps {fps:g}")
    taken = [_of_exif(path) for path in pictures[:2]]
    if len(taken) < 2 or None in taken or taken[0] == taken[1]:
        return FrameTimes(none, none)
    seconds = np.array([_of_exif(path) or np.nan for path in pictures])
    return FrameTimes(seconds, none, "EXIF")


def column_in_seconds(cells: "pd.Series", unit: str, name: str) -> np.ndarray:
    """A column of numbers in a unit, or of ISO 8601 times, in seconds; NaN in empty cells.

    Raises:
        InputError: a cell is neither.
    """
    import pandas as pd

    numbers = pd.to_numeric(cells, errors="coerce")
    bad = numbers.isna() & cells.notna()
    if bad.any():
        instants = pd.to_datetime(cells, errors="coerce", format="ISO8601", utc=True)
        if instants.isna().any():
            row = int(np.flatnonzero((instants.isna() & cells.notna()).to_numpy())[0])
            raise InputError(
                f"line {row + 2}: {name} must be a number or an ISO 8601 time; got "
                f"{shortened(cells.iloc[row])}"
            )
        return (instants - pd.Timestamp(0, tz="UTC")).dt.total_seconds().to_numpy()
    if not np.isfinite(numbers.dropna()).all():
        raise InputError(f"{name} must be finite")
    return numbers.to_numpy(float) * UNITS_S[unit]


def _of_table(path: Path, names: Sequence[str]) -> FrameTimes:
    import pandas as pd

    try:
        # Read as text: times in ns have more digits than a float.
        table = pd.read_csv(path, dtype=str, skipinitialspace=True)
    except (ValueError, UnicodeDecodeError) as error:
        raise InputError(f"no table: {error}".strip()) from error
    files = next((name for name in ("file", "file_name", "filename") if name in table), None)
    if files is None:
        raise InputError(f"column 'file' is missing; it has {', '.join(table.columns)}")
    table = table.set_index(table[files].map(lambda name: Path(str(name)).name))
    if table.index.has_duplicates:
        raise InputError(f"{table.index[table.index.duplicated()][0]} stands in it twice")
    missing = [name for name in names if name not in table.index]
    if missing:
        raise InputError(f"{len(missing)} of {len(names)} images are not in it, as {missing[0]}")
    columns = {
        kind: next(
            (
                (f"{kind}{end}", unit)
                for end, unit in [
                    ("_s", "s"),
                    ("_ms", "ms"),
                    ("_us", "us"),
                    ("_ns", "ns"),
                    ("", "s"),
                ]
                if f"{kind}{end}" in table
            ),
            None,
        )
        for kind in ("time", "exposure")
    }
    if columns["time"] is None:
        raise InputError(f"column 'time_s' is missing; it has {', '.join(table.columns)}")
    none = np.full(len(names), np.nan)
    found = {
        kind: none if column is None else column_in_seconds(table[column[0]], column[1], column[0])
        for kind, column in columns.items()
    }
    order = table.index.get_indexer(pd.Index(names))
    times, exposures = (found[kind][order] if columns[kind] else none for kind in found)
    backwards = np.flatnonzero(np.diff(times) <= 0)
    if backwards.size:
        n = int(backwards[0])
        raise InputError(
            f"time must grow with the images' names; {names[n]} is of {times[n]:.6f} s, and "
            f"{names[n + 1]} of {times[n + 1]:.6f} s"
        )
    if (exposures <= 0).any():
        raise InputError(f"exposure must be positive; got {np.nanmin(exposures):g} s")
    return FrameTimes(times, exposures, str(path))


def _of_exif(path: Path) -> float | None:
    """When an image was taken, s since 1970; None if the file does not say."""
    from PIL import Image

    try:
        with Image.open(path) as image:
            tags = image.getexif().get_ifd(_EXIF)
        taken = datetime.strptime(str(tags[_TAKEN]), "%Y:%m:%d %H:%M:%S")
        return taken.timestamp() + float(f"0.{tags.get(_FRACTION, 0)}")
    except (KeyError, ValueError, OSError, SyntaxError):
        return None
