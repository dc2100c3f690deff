"""Spots of a set: read from files, or measured by our estimator."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import replace
from pathlib import Path

from benchmarks.sets.read.labelled_set import SetStack
from benchmarks.sets.read.stacks import (
    Mode,
    exposures_of,
    image_name,
    own_reader,
    qualified_name,
    true_beam,
)
from benchmarks.sets.score.plain_spots import read_any_spots
from estimator import (
    Calibration,
    SpotRecord,
    open_source,
    read_microscope,
    track_whole_source,
)
from optics import InputError

SPOTS_SUFFIXES = (".csv", ".parquet")
"""Suffixes of spots files."""
_NAMED = 5  # unknown names listed in a message


def read_set_spots(
    path: str | Path, stacks: Sequence[SetStack], images: Collection[str]
) -> dict[str, SpotRecord]:
    """Read an estimator's spots of a set.

    Args:
        path: a spots file with image names relative to the set (SPLIT/STACK/frames/000000.png); or
            a folder with such a file of any name; or a folder with a spots file for each stack, as
            `eyespot track` writes it. Its name is SPLIT/STACK.csv or, if a stack has several
            exposures, SPLIT/STACK.EXPOSURE.csv. For a single stack, omit SPLIT/. A spots file is
            that of eyespot (.csv or .parquet), or plain (`plain_spots`).
        images: names of all images of the set.

    Returns:
        The records by image name.

    Raises:
        InputError: the file is missing, names are not in the set, or an image has two lines.
    """
    path = Path(path)
    if path.is_dir():
        records = [record for file in _files(path) for record in _placed(file, path, stacks)]
    elif path.is_file():
        records = read_any_spots(path)
    else:
        raise InputError(f"{path}: no such spots file or folder. Check the path.")
    return _by_image(records, path, images)


def track_set(
    stacks: Iterable[SetStack],
    mode: Mode,
    *,
    calibration: Calibration | None = None,
    progress: Callable[[], None] = lambda: None,
) -> list[SpotRecord]:
    """Measure every frame of a set; each stack and exposure is one recording.

    The literal mode starts at the true position of the first spot of each recording, as the paper's
    operator clicks on it. The other modes find the spot themselves. The mode pixels gets the beam,
    but not the robot's poses. Like the labels, the spots are in the original image, with its
    distortion.

    Args:
        mode: mode of the estimator, with its default settings.
        calibration: of the beam, for the mode pixels; None for each stack's true one.

    Returns:
        Records with image names relative to the set.

    Raises:
        InputError: the mode pixels cannot read a stack; the text says why.
    """
    return [
        replace(record, file_name=image_name(entry, record.file_name))
        for entry in stacks
        for exposure in exposures_of(entry.open())
        for record in _track(entry, exposure, mode, calibration, progress)
    ]


def _track(
    entry: SetStack,
    exposure: str,
    mode: Mode,
    calibration: Calibration | None,
    progress: Callable[[], None],
) -> list[SpotRecord]:
    opened = entry.open()
    first = opened.exposed(exposure)[0]
    reader = own_reader(
        mode,
        read_microscope(entry.folder / "microscope.json"),
        click=(first.half_max_x_px, first.half_max_y_px),
        beam=(calibration or true_beam(opened)) if mode == "pixels" else None,
    )
    source = open_source(entry.folder, exposure=exposure)
    return track_whole_source(source, reader, progress=lambda record: progress())


def _files(folder: Path) -> list[Path]:
    files = sorted(path for path in folder.rglob("*") if path.suffix.lower() in SPOTS_SUFFIXES)
    if not files:
        raise InputError(f"{folder} contains no spots files (.csv or .parquet). Check the path.")
    return files


def _placed(file: Path, folder: Path, stacks: Sequence[SetStack]) -> list[SpotRecord]:
    """Records of one stack's spots file, with image names relative to the set."""
    by_name = {qualified_name(entry): entry for entry in stacks}
    name = file.relative_to(folder).with_suffix("").as_posix()
    entry = by_name.get(name) or by_name.get(name.rpartition(".")[0])
    if entry is None and "/" not in name and stacks[0].split:
        return read_any_spots(file)  # of the whole set
    if entry is None:
        raise InputError(
            f"{file}: the set has no stack {name}. Name the file SPLIT/STACK.csv or "
            f"SPLIT/STACK.EXPOSURE.csv; the first stack is {qualified_name(stacks[0])}."
        )
    return [
        replace(record, file_name=image_name(entry, record.file_name))
        for record in read_any_spots(file)
    ]


def _by_image(
    records: Iterable[SpotRecord], path: Path, images: Collection[str]
) -> dict[str, SpotRecord]:
    found: dict[str, SpotRecord] = {}
    unknown = []
    for record in records:
        if record.file_name in found:
            raise InputError(f"{path}: {record.file_name} has two lines. Remove one of them.")
        if record.file_name not in images:
            unknown.append(record.file_name)
        found[record.file_name] = record
    if unknown:
        listed = ", ".join(repr(name) for name in unknown[:_NAMED])
        more = f" and {len(unknown) - _NAMED} more" if len(unknown) > _NAMED else ""
        raise InputError(
            f"{path}: the set does not contain {listed}{more}. Image names are relative to the "
            f"set, such as {min(images)}."
        )
    if not found:
        raise InputError(f"{path} is empty.")
    return found
