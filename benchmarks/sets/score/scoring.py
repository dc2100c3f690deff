"""The whole run: reads or measures spots, scores them, prints and writes tables."""

from __future__ import annotations

import csv
import math
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Literal

import matplotlib
from rich.console import Console

from benchmarks.evaluation import VISIBLE_ENOUGH
from benchmarks.reporting import STYLE, save_figure, versions, write_json
from benchmarks.sets.read import stacks_of
from benchmarks.sets.score.conditions import circumstances_of
from benchmarks.sets.score.figure import score_figure
from benchmarks.sets.score.groups import Score, score
from benchmarks.sets.score.measures import Counts, Errors
from benchmarks.sets.score.outcomes import Against, Outcome
from benchmarks.sets.score.spots_of_set import Mode, read_set_spots, track_set
from benchmarks.sets.score.table import tables
from estimator import SpotRecord, write_spots
from estimator.files import fingerprint, require_space, written_whole
from estimator.run import progress
from optics import InputError

_SCHEMA = 1
_LEAST_BYTES = 2**18  # of the figures


def run(
    folder: Path,
    spots_files: Sequence[Path],
    *,
    mode: Mode | Literal["both"] | None = None,
    against: Against = "half_max",
    out: Path | None = None,
) -> None:
    """Score spots files and modes of our estimator on a set.

    Args:
        folder: a set or a stack.
        spots_files: see `read_set_spots`; the name of a file is the name of the estimator.
        mode: mode of our estimator that measures the images first.
        against: which of the two ellipses is the truth.
        out: new folder for score.json, score.csv, score.png, score.svg, and MODE.csv with the
            measured spots; None: only print the tables.

    Raises:
        InputError: the input is invalid, or `out` exists.
        OSError: `out` cannot be written.
    """
    folder = Path(folder)
    modes: tuple[Mode, ...] = ("literal", "subpixel")
    modes = modes if mode == "both" else (mode,) if mode else ()
    _check([*map(_estimator, spots_files), *modes])
    if out is None:
        _scored(folder, spots_files, modes, against)
        return
    with written_whole(out) as whole:
        whole.mkdir()
        require_space(out, _LEAST_BYTES)
        result, measured = _scored(folder, spots_files, modes, against)
        _write(result, whole, folder)
        for name, records in measured.items():
            write_spots(whole / f"{name}.csv", records)
    print(f"Wrote {out}.")


def _scored(
    folder: Path, spots_files: Sequence[Path], modes: Sequence[Mode], against: Against
) -> tuple[Score, dict[str, list[SpotRecord]]]:
    """Measure, score and print; returns also the spots that were measured, by mode."""
    files = {_estimator(path): path for path in spots_files}
    stacks = stacks_of(folder)
    images = circumstances_of(stacks)
    spots = {name: read_set_spots(path, stacks, images) for name, path in files.items()}
    measured: dict[str, list[SpotRecord]] = {}
    with progress("Tracking", total=len(images) * len(modes)) as advance:
        for mode in modes:
            measured[mode] = track_set(stacks, mode, progress=advance)
            spots[mode] = {record.file_name: record for record in measured[mode]}
    result = score(images, spots, against=against)
    for table in tables(result):
        Console().print(table)
    return result, measured


def _estimator(spots: Path) -> str:
    """Name of an estimator, from its spots file or folder."""
    return spots.stem if spots.suffix else spots.resolve().name


def _check(names: Sequence[str]) -> None:
    if not names:
        raise InputError("nothing to score. Give spots files, or --mode to measure the images.")
    if twice := [name for name, count in Counter(names).items() if count > 1]:
        raise InputError(f"two estimators have the name {twice[0]}. Rename one of the spots files.")


def _write(result: Score, out: Path, folder: Path) -> None:
    write_json(out / "score.json", _summary(result, folder))
    with (out / "score.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(
            ["estimator", "against", "condition", "group", *Counts._fields, *Errors._fields]
        )
        for group in result.groups:
            about = [group.estimator, result.against, group.condition, group.group, *group.counts]
            for errors in group.errors:
                writer.writerow([*about, *map(_cell, errors)])
            if not group.errors:
                writer.writerow(about + [""] * len(Errors._fields))
    with matplotlib.rc_context(STYLE):
        save_figure(score_figure(result), out / "score")


def _cell(value: object) -> object:
    return "" if isinstance(value, float) and math.isnan(value) else value


def _summary(result: Score, folder: Path) -> dict[str, object]:
    """Content of score.json."""
    manifest = folder / "manifest.json"
    return {
        "schema": _SCHEMA,
        "set": folder.resolve().name,
        "manifest": fingerprint(manifest) if manifest.is_file() else None,
        "against": result.against,
        "visible_from_fraction": VISIBLE_ENOUGH,
        "outcomes": {
            name: Counter(image.outcome.value for image in judged)
            for name, judged in result.judged.items()
        },
        "reasons_of_misses": {
            name: Counter(
                image.record.reason if image.record else "no line"
                for image in judged
                if image.outcome is Outcome.MISSED
            )
            for name, judged in result.judged.items()
        },
        "left_out": result.left_out,
        "groups": [
            {
                "estimator": group.estimator,
                "condition": group.condition,
                "group": group.group,
                **group.counts._asdict(),
                "errors": [errors._asdict() for errors in group.errors],
            }
            for group in result.groups
        ],
        "versions": versions(),
    }
