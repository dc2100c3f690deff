"""Spots of a set: read from files, or measured by our estimator."""

import difflib
import math
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from importlib import resources
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import AfterValidator, ConfigDict, Field, create_model
from pydantic.json_schema import SkipJsonSchema

from eyespot.benchmarks.sets.read import (
    Mode,
    SetStack,
    exposures_of,
    own_reader,
    plain_spot,
    true_beam,
)
from eyespot.estimator import SubpixelSettings, open_source, track_whole_source
from eyespot.estimator.detector.verdict import continues
from eyespot.estimator.run.progress_bar import say
from eyespot.formats.calibration import Calibration
from eyespot.formats.inputs import (
    InputError,
    Strict,
    csv_rows,
    in_file,
    in_utf8,
    number_in,
    object_in,
    read_text,
    shortened,
    validated,
)
from eyespot.formats.microscope import read_microscope
from eyespot.formats.spot import NoSpot, Reason, Spot
from eyespot.formats.spots import SpotRecord, SpotRow, folded_angle, read_spots
from eyespot.formats.stack import FrameLabels

NAME = "sample-v2"  # The small set that comes with eyespot.


def sample_folder() -> Path:
    """Folder of the set that comes with eyespot; InputError if eyespot lacks its data."""
    folder = Path(str(resources.files("eyespot.benchmarks.sets.score"))) / NAME
    if not (folder / "set.json").is_file():
        raise InputError(f"{folder} is missing. Install eyespot again from its wheel.")
    return folder


# Plain spots files: the few columns that an estimator of others can write without eyespot; see
# docs/leaderboard.md. An image without a spot has empty cells, or no line.

ELLIPSE = ("x_px", "y_px", "semi_major_px", "semi_minor_px")  # all are scored, so all are needed
_PARAMETERS = (*ELLIPSE, "angle_rad")
_NUMBERS: dict[str, Any] = {
    **{
        name: (float, SpotRow.model_fields[name])
        for name in (*_PARAMETERS, "distance_mm", "sigma_distance_mm")
    },
    **{
        f"sigma_{name}": (float, Field(math.nan, ge=0, description=f"Standard error of `{name}`."))
        for name in _PARAMETERS
    },
}
PlainRow = create_model(
    "PlainRow",
    __base__=Strict,
    __doc__="A row of a plain spots file, without its empty cells.",
    file_name=(Annotated[str, Field(min_length=1)], Field(description="Of the image in the set.")),
    **_NUMBERS,
)
COLUMNS = tuple(PlainRow.model_fields)


def read_any_spots(path: Path) -> list[SpotRecord]:
    """Read a spots file: that of eyespot, which has a column `schema_version`, or a plain CSV.

    Raises:
        InputError: neither of the two, or a wrong value; the message names the file and the line.
    """
    names: list[str] = []
    if path.suffix.lower() == ".csv":
        next(csv_rows(path, check=names.extend), None)
    if path.suffix.lower() != ".csv" or "schema_version" in names:
        return read_spots(path)
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
    numbers = {name: number_in(row.get(name, ""), name) for name in COLUMNS[1:]}
    known = {name: value for name, value in numbers.items() if not math.isnan(value)}
    named = known | {"file_name": row["file_name"]}
    cells: Any = validated(PlainRow, named, remedy="See docs/leaderboard.md.")
    return SpotRecord(
        frame=index,
        file_name=cells.file_name,
        time_s=math.nan,
        mode="",
        result=_spot(cells),
        distance_mm=cells.distance_mm,
        sigma_distance_mm=cells.sigma_distance_mm,
    )


def _spot(cells: Any) -> Spot | NoSpot:
    x, y, major, minor = ellipse = [getattr(cells, name) for name in ELLIPSE]
    unknown = [name for name, value in zip(ELLIPSE, ellipse, strict=True) if math.isnan(value)]
    if len(unknown) == len(ELLIPSE):
        return NoSpot(Reason.NONE_FOUND)
    if unknown:
        raise InputError(
            f"{unknown[0]} is empty. Fill in all of {', '.join(ELLIPSE)}, or none if the image has "
            "no spot."
        )
    if major < minor:
        raise InputError(
            f"semi_major_px must be at least semi_minor_px; got {major} and {minor} px. Swap them; "
            "they are halves of the axes."
        )
    angle = cells.angle_rad if math.isnan(cells.angle_rad) else folded_angle(cells.angle_rad)
    covariance = np.diag([getattr(cells, f"sigma_{name}") ** 2 for name in _PARAMETERS])
    return plain_spot(x, y, major, minor, angle, covariance)


SPOTS_SUFFIXES = (".csv", ".parquet")
_MAX_NAMES_SAID = 5


def read_set_spots(
    path: str | Path, stacks: Sequence[SetStack], images: Collection[str]
) -> dict[str, SpotRecord]:
    """Read an estimator's spots of a set, by image name.

    Args:
        path: a spots file with image names relative to the set (SPLIT/STACK/frames/000000.png); or
            a folder with such a file of any name; or a folder with a spots file for each stack, as
            `eyespot track` writes it. Its name is SPLIT/STACK.csv or, if a stack has several
            exposures, SPLIT/STACK.EXPOSURE.csv. For a single stack, omit SPLIT/. A spots file is
            that of eyespot (.csv or .parquet), or plain (`read_any_spots`).
        images: names of all images of the set.

    Raises:
        InputError: the file is missing, names are not in the set, or an image has two lines.
    """
    path = Path(path)
    if path.is_file():
        records = read_any_spots(path)
    elif path.is_dir():
        files = sorted(file for file in path.rglob("*") if file.suffix.lower() in SPOTS_SUFFIXES)
        if not files:
            raise InputError(f"{path} contains no spots files (.csv or .parquet). Check the path.")
        records = [record for file in files for record in _placed(file, path, stacks)]
    else:
        raise InputError(f"{path}: no such spots file or folder. Check the path.")
    found: dict[str, SpotRecord] = {}
    for record in records:
        if record.file_name in found:
            raise InputError(f"{path}: {record.file_name} has two lines. Remove one of them.")
        found[record.file_name] = record
    if unknown := [name for name in found if name not in images]:
        listed = ", ".join(repr(name) for name in unknown[:_MAX_NAMES_SAID])
        more = (
            f" and {len(unknown) - _MAX_NAMES_SAID} more" if len(unknown) > _MAX_NAMES_SAID else ""
        )
        raise InputError(
            f"{path}: the set does not contain {listed}{more}. Image names are relative to the "
            f"set, such as {min(images)}."
        )
    if not found:
        raise InputError(f"{path} is empty.")
    return found


def track_set(
    stacks: Iterable[SetStack],
    mode: Mode,
    *,
    calibration: Calibration | None = None,
    unrelated: bool | None = None,
    progress: Callable[[], None] = lambda: None,
) -> list[SpotRecord]:
    """Measure every frame of a set; each stack and exposure is one recording (`own_reader`).

    Like the labels, the spots are in the original image, with its distortion. The records have
    image names relative to the set.

    Args:
        calibration: of the beam, for auto and pixels; None for each stack's true one.
        unrelated: measure every image by itself, without following the spot; None: in stacks most
            of whose spots lie too far from the one before to be followed.

    Raises:
        InputError: the mode pixels cannot read a stack; the text says why.
    """
    records: list[SpotRecord] = []
    for entry in stacks:
        opened, microscope = entry.open(), read_microscope(entry.folder / "microscope.json")
        # Nothing says what the source of a stack is that was not rendered.
        knows_beam = mode == "pixels" or (mode == "auto" and "scene" in opened.description)
        beam = calibration or (true_beam(opened) if knows_beam else None)
        for exposure in exposures_of(opened):
            labels, source = opened.exposed(exposure), open_source(entry.folder, exposure=exposure)
            click = labels[0].half_max_x_px, labels[0].half_max_y_px
            reader = own_reader(mode, microscope, click=click, beam=beam)
            alone = not _is_sequence(labels) if unrelated is None else unrelated
            found = track_whole_source(
                replace(source, unrelated=alone), reader, progress=lambda record: progress()
            )
            records += [replace(r, file_name=entry.image_name(r.file_name)) for r in found]
    if mode == "auto":
        used = Counter(record.mode for record in records)
        by_mode = " and ".join(f"{count} images in mode {name}" for name, count in used.items())
        say(f"Measured {by_mode}: pixels for a lens if the camera's noise is known, else subpixel.")
    return records


def _is_sequence(labels: Sequence[FrameLabels]) -> bool:
    """Whether at least half of the true spots can be followed from the one before."""
    true = ([getattr(of, f"half_max_{name}") for name in _PARAMETERS] for of in labels)
    steps, limits = [*pairwise(plain_spot(*ellipse) for ellipse in true)], SubpixelSettings()
    return 2 * sum(continues(spot, last, limits) for last, spot in steps) >= len(steps)


def _placed(file: Path, folder: Path, stacks: Sequence[SetStack]) -> list[SpotRecord]:
    """Records of one stack's spots file, with image names relative to the set."""
    by_name = {entry.qualified_name: entry for entry in stacks}
    name = file.relative_to(folder).with_suffix("").as_posix()
    entry = by_name.get(name) or by_name.get(name.rpartition(".")[0])
    if entry is None and "/" not in name and stacks[0].split:
        return read_any_spots(file)  # of the whole set
    if entry is None:
        raise InputError(
            f"{file}: the set has no stack {name}. Name the file SPLIT/STACK.csv or "
            f"SPLIT/STACK.EXPOSURE.csv; the first stack is {stacks[0].qualified_name}."
        )
    return [
        replace(record, file_name=entry.image_name(record.file_name))
        for record in read_any_spots(file)
    ]


# Entries of a leaderboard: a folder with a spots file or folder for each estimator.

_Text = Annotated[str, Field(max_length=1000)]


def _in_a_table(name: str) -> str:
    """A name that a spreadsheet does not run as a formula."""
    if name[:1] in "=+-@\t\r":
        raise InputError("must begin with a letter or a digit")
    return name


def _said(versions: dict[str, str] | str) -> str:
    if isinstance(versions, str):
        return versions
    return ", ".join(f"{package} {version}" for package, version in versions.items())


class ScoredEstimator(Strict):
    """An estimator whose spots are scored, as its entry.json describes it."""

    model_config = ConfigDict(extra="ignore")  # an entrant may say more

    name: Annotated[_Text, AfterValidator(_in_a_table)] = Field(
        "", description="In tables and figures (default: that of its file or folder)."
    )
    command: _Text = Field("", description="The command that wrote the spots.")
    versions: Annotated[dict[_Text, _Text] | _Text, AfterValidator(_said)] = Field(
        "", description="Versions of its software."
    )
    seed: Annotated[int | _Text, AfterValidator(str)] = Field("", description="Its random seed.")
    ms_per_frame: Annotated[float, Field(ge=0)] | None = Field(
        None, description="Its time per frame, ms."
    )
    spots: SkipJsonSchema[Path | None] = Field(None, exclude=True)
    """Its file or folder, see `read_set_spots`; None if the images are measured in this run."""


def entry_of(spots: Path) -> ScoredEstimator:
    """The entry of a spots file or folder; a folder's entry.json may describe it."""
    named, file = spots.stem if spots.suffix else spots.resolve().name, spots / "entry.json"
    about: dict[str, Any] = {"name": in_utf8(named)}
    with in_file(file if file.is_file() else spots):
        if file.is_file():
            stated = object_in(read_text(file))
            about |= {key: value for key, value in stated.items() if value is not None}
        remedy = "Correct its entry.json, or rename its spots file; see docs/leaderboard.md."
        return validated(ScoredEstimator, about | {"spots": spots}, remedy=remedy)


def entries_in(folder: Path) -> list[ScoredEstimator]:
    """The entries in a folder, by name: each a folder, or a spots file; InputError if none."""
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder. Give the folder that contains the entries.")
    found = [
        entry_of(path)
        for path in sorted(folder.iterdir())
        if not path.name.startswith(".")
        and (path.is_dir() or path.suffix.lower() in SPOTS_SUFFIXES)
    ]
    if not found:
        raise InputError(
            f"{folder} has no entries. An entry is a spots file, or a folder with spots files."
        )
    return found
