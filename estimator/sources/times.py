"""When the images of a folder were taken: frames.csv beside them, EXIF, or a rate."""

import warnings
from collections.abc import Sequence
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from eyespot.formats.inputs import InputError, shortened
from eyespot.formats.tables import SECONDS, lines_of, read_table, seconds

if TYPE_CHECKING:
    import pandas as pd

TABLE = "frames.csv"
"""The table beside the images: `file,time_s,exposure_s`, in any order; other units are time_ms,
time_us and time_ns, or times after ISO 8601."""
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
        return _of_table(table, [path.name for path in pictures])
    if fps is not None:
        return FrameTimes(np.arange(len(pictures)) / fps, none, f"--fps {fps:g}")
    taken = [_of_exif(path) for path in pictures[:2]]
    if len(taken) < 2 or None in taken or taken[0] == taken[1]:
        return FrameTimes(none, none)
    seconds = np.array([_of_exif(path) or np.nan for path in pictures])
    return FrameTimes(seconds, none, "EXIF")


def _of_table(path: Path, names: Sequence[str]) -> FrameTimes:
    import pandas as pd

    table, place = read_table(path), lines_of(path)
    files = next((name for name in ("file", "file_name", "filename") if name in table), None)
    time = _column(table, "time")
    if files is None or time is None:
        listed = shortened(", ".join(map(str, table.columns)))
        raise InputError(
            f"{path}: column {'file' if files is None else 'time_s'!r} is missing; it has "
            f"{listed}. Write file,time_s,exposure_s above the rows."
        )
    images = pd.Index([Path(f"{name}").name for name in table[files]])
    if images.has_duplicates:
        twice = shortened(images[images.duplicated()][0])
        raise InputError(f"{path}: {twice} stands in it twice. Remove one of the rows.")
    order = images.get_indexer(pd.Index(names))
    missing = [name for name, row in zip(names, order, strict=True) if row < 0]
    if missing:
        raise InputError(
            f"{path}: {len(missing)} of {len(names)} images are not in it, as {missing[0]}. "
            "Add their rows, or move the images away."
        )
    times = seconds(table[time[0]], place, unit_s=time[1])[order]
    backwards = np.flatnonzero(np.diff(times) < 0)
    if backwards.size:
        n = int(backwards[0])
        raise InputError(
            f"{path}: times must grow with the images' names; {names[n]} is of {times[n]:.6f} s, "
            f"and {names[n + 1]} of {times[n + 1]:.6f} s."
        )
    exposure = _column(table, "exposure")
    exposures = np.full(len(names), np.nan)
    if exposure is not None:
        exposures = seconds(table[exposure[0]], place, unit_s=exposure[1])[order]
        if exposures.min() <= 0:
            raise InputError(f"{path}: exposures must be positive; got {exposures.min():g} s.")
    return FrameTimes(times, exposures, str(path))


def _column(table: "pd.DataFrame", kind: str) -> tuple[str, float] | None:
    """The column of a kind, such as time_ms, and its unit in seconds."""
    for unit, unit_s in SECONDS.items():
        if f"{kind}_{unit}" in table:
            return f"{kind}_{unit}", unit_s
    return (kind, 1.0) if kind in table else None


def _of_exif(path: Path) -> float | None:
    """When an image was taken, s since 1970; None if the file does not say."""
    from PIL import Image

    try:
        # A file that Pillow doubts is judged when its pixels are read.
        with warnings.catch_warnings(action="ignore"), Image.open(path) as image:
            tags = image.getexif().get_ifd(_EXIF)
        taken = datetime.strptime(str(tags[_TAKEN]), "%Y:%m:%d %H:%M:%S")
        return taken.timestamp() + float(f"0.{tags.get(_FRACTION, 0)}")
    except Exception:  # decoders raise all kinds of errors for damage
        return None
