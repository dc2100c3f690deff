"""Plain spots files: the few columns that an estimator of others can write without eyespot.

    file_name,x_px,y_px,semi_major_px,semi_minor_px
    test/0000/frames/000000.png,322.41,240.18,61.02,58.77
    test/0000/frames/000001.png,,,,

An image without a spot has empty cells, or no line. Further columns may be `angle_rad`, a standard
deviation `sigma_` of each value, `distance_mm` and `sigma_distance_mm`. A file may also have
distances alone.
"""

from __future__ import annotations

import difflib
import math
from collections.abc import Collection, Mapping
from pathlib import Path

import numpy as np

from estimator import NoSpot, Reason, Spot, SpotRecord, read_spots
from estimator.files import csv_rows, number_in
from optics import InputError, in_file, shortened

ELLIPSE = ("x_px", "y_px", "semi_major_px", "semi_minor_px")
"""Columns of an ellipse; all of them are needed, since the four values are scored."""
_ANGLE = "angle_rad"
_DISTANCE = ("distance_mm", "sigma_distance_mm")
_SIGMAS = tuple(f"sigma_{name}" for name in (*ELLIPSE, _ANGLE))
COLUMNS = ("file_name", *ELLIPSE, _ANGLE, *_SIGMAS, *_DISTANCE)
"""All columns that a plain spots file may have."""

_LARGEST_PX = 1e6
_LARGEST_RAD = 4.0  # an angle of 0 to pi is accepted, too


def read_any_spots(path: Path) -> list[SpotRecord]:
    """Read a spots file: that of eyespot, or a plain CSV.

    Files of eyespot are recognised by their column `schema_version`.

    Raises:
        InputError: neither of the two, or a wrong value; the message names the file and the line.
    """
    if path.suffix.lower() == ".csv" and not _is_of_eyespot(path):
        return _read_plain(path)
    return read_spots(path)


def _is_of_eyespot(path: Path) -> bool:
    names: list[str] = []
    next(csv_rows(path, check=names.extend), None)
    return "schema_version" in names


def _read_plain(path: Path) -> list[SpotRecord]:
    records: list[SpotRecord] = []
    for row, where in csv_rows(path, check=_check_columns):
        with in_file(where):
            records.append(_record(len(records), row))
    return records


def _check_columns(names: Collection[str]) -> None:
    if unknown := [name for name in names if name not in COLUMNS]:
        near = difflib.get_close_matches(unknown[0], COLUMNS, n=1)
        raise InputError(
            f"unknown column {shortened(unknown[0])}"
            f"{f'; did you mean {near[0]}?' if near else '.'} The columns of a plain spots file "
            f"are {', '.join(COLUMNS)}. Rename or remove it."
        )
    has_ellipse = [name for name in ELLIPSE if name in names]
    needed = ELLIPSE if has_ellipse or "distance_mm" not in names else ()
    if missing := [name for name in ("file_name", *needed) if name not in names]:
        raise InputError(
            f"column {missing[0]} is missing. A plain spots file needs file_name and "
            f"{', '.join(ELLIPSE)}, or file_name and distance_mm."
        )


def _record(index: int, row: Mapping[str, str]) -> SpotRecord:
    values = {name: number_in(row.get(name, ""), name) for name in COLUMNS[1:]}
    if not row["file_name"]:
        raise InputError("file_name is empty. Write the image's path within the set.")
    for name in (*_SIGMAS, "sigma_distance_mm"):
        if values[name] < 0:
            raise InputError(f"{name} must not be negative; got {values[name]}.")
    return SpotRecord(
        frame=index,
        file_name=row["file_name"],
        time_s=math.nan,
        mode="",
        result=_spot(values),
        distance_mm=values["distance_mm"],
        sigma_distance_mm=values["sigma_distance_mm"],
    )


def _spot(values: Mapping[str, float]) -> Spot | NoSpot:
    unknown = [name for name in ELLIPSE if math.isnan(values[name])]
    if len(unknown) == len(ELLIPSE):
        return NoSpot(Reason.NONE_FOUND)
    if unknown:
        raise InputError(
            f"{unknown[0]} is empty. Fill in all of {', '.join(ELLIPSE)}, or none if the image has "
            "no spot."
        )
    for name in ELLIPSE:
        low = -_LARGEST_PX if name in ("x_px", "y_px") else 0.0
        if not low < values[name] < _LARGEST_PX:
            raise InputError(
                f"{name} must lie in ({low:g}, {_LARGEST_PX:g}) px; got {values[name]}."
            )
    if values["semi_major_px"] < values["semi_minor_px"]:
        raise InputError(
            f"semi_major_px must be at least semi_minor_px; got {values['semi_major_px']} and "
            f"{values['semi_minor_px']} px. Swap them; they are halves of the axes."
        )
    if abs(values[_ANGLE]) > _LARGEST_RAD:
        raise InputError(
            f"{_ANGLE} must lie in (-pi/2, pi/2]; got {values[_ANGLE]}. Write radians, not degrees."
        )
    unmeasured = dict.fromkeys(
        ("edge_width_px", "coverage", "inlier_fraction", "saturated"), math.nan
    )
    return Spot(
        **{name: values[name] for name in (*ELLIPSE, _ANGLE)},
        covariance=np.diag([values[name] ** 2 for name in _SIGMAS]),
        **unmeasured,
    )
