"""Spots of a whole set: read from files, or measured by our own estimator."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Literal

from benchmarks.sets.read import SetStack, exposures_of, image_name, qualified_name
from estimator import (
    LiteralSettings,
    Reader,
    SpotRecord,
    SubpixelSettings,
    open_source,
    read_microscope,
    read_spots,
    track_source,
)

Mode = Literal["literal", "subpixel"]

_SPOTS = (".csv", ".parquet")
_NAMED = 5  # wrong names that a message lists


def read_set_spots(
    path: str | Path, stacks: Sequence[SetStack], images: Collection[str]
) -> dict[str, SpotRecord]:
    """Read an estimator's spots of a set.

    Args:
        path: a spots file whose file names start at the set (SPLIT/STACK/frames/000000.png), or a
            folder with the spots file of each stack as `eyespot track` writes it, named
            SPLIT/STACK.csv or, where a stack holds several exposures, SPLIT/STACK.EXPOSURE.csv.
            Without SPLIT/ for a stack by itself. Parquet does as well.
        stacks: of the set.
        images: names of all images of the set.

    Returns:
        The records by the image's name in the set.

    Raises:
        ValueError: no such file, names that the set does not hold (all are told in one message), or
            two lines for one image.
    """
    path = Path(path)
    if path.is_dir():
        records = [record for file in _files(path) for record in _placed(file, path, stacks)]
    elif path.is_file():
        records = read_spots(path)
    else:
        raise ValueError(f"{path}: there is no such spots file or folder. Check the path.")
    return _by_image(records, path, images)


def track_set(
    stacks: Iterable[SetStack], mode: Mode, *, progress: Callable[[], None] = lambda: None
) -> list[SpotRecord]:
    """Measure every frame of a set, each stack and exposure as a recording of its own.

    The literal mode starts at the true place of each recording's first spot, as the paper's
    operator clicks on it; the sub-pixel mode finds it. Spots lie in the image as it is, as labels
    do: the lens's distortion is not taken out.

    Args:
        stacks: stacks of the set.
        mode: of the estimator, with its default settings.
        progress: called after each frame.

    Returns:
        Records whose file names start at the set.
    """
    return [
        replace(record, file_name=image_name(entry, record.file_name))
        for entry in stacks
        for exposure in exposures_of(entry.open())
        for record in _track(entry, exposure, mode, progress)
    ]


def _track(
    entry: SetStack, exposure: str, mode: Mode, progress: Callable[[], None]
) -> list[SpotRecord]:
    response = read_microscope(entry.folder / "microscope.json").response
    first = entry.open().exposed(exposure)[0]
    if mode == "literal":
        click = first.half_max_x_px, first.half_max_y_px
        reader = Reader(LiteralSettings(response=response), start=click)
    else:
        reader = Reader(SubpixelSettings(response=response))
    source = open_source(entry.folder, exposure=exposure)
    tracking = track_source(source, reader, progress=lambda record: progress())
    if tracking.fault:
        raise ValueError(tracking.fault)
    return tracking.records


def _files(folder: Path) -> list[Path]:
    files = sorted(path for path in folder.rglob("*") if path.suffix.lower() in _SPOTS)
    if not files:
        raise ValueError(f"{folder} holds no spots files (.csv or .parquet). Check the path.")
    return files


def _placed(file: Path, folder: Path, stacks: Sequence[SetStack]) -> list[SpotRecord]:
    """Records of one stack's spots file, named as the set names them."""
    by_name = {qualified_name(entry): entry for entry in stacks}
    name = file.relative_to(folder).with_suffix("").as_posix()
    entry = by_name.get(name) or by_name.get(name.rpartition(".")[0])
    if entry is None:
        raise ValueError(
            f"{file}: the set has no stack {name}. Name the file SPLIT/STACK.csv or "
            f"SPLIT/STACK.EXPOSURE.csv; the first stack is {qualified_name(stacks[0])}."
        )
    return [
        replace(record, file_name=image_name(entry, record.file_name))
        for record in read_spots(file)
    ]


def _by_image(
    records: Iterable[SpotRecord], path: Path, images: Collection[str]
) -> dict[str, SpotRecord]:
    found: dict[str, SpotRecord] = {}
    unknown = []
    for record in records:
        if record.file_name in found:
            raise ValueError(f"{path}: {record.file_name} has two lines. Leave one of them.")
        if record.file_name not in images:
            unknown.append(record.file_name)
        found[record.file_name] = record
    if unknown:
        listed = ", ".join(repr(name) for name in unknown[:_NAMED])
        more = f" and {len(unknown) - _NAMED} more" if len(unknown) > _NAMED else ""
        raise ValueError(
            f"{path}: the set does not hold {listed}{more}. File names start at the set, such as "
            f"{min(images)}."
        )
    if not found:
        raise ValueError(f"{path} holds no lines.")
    return found
