"""The whole run: reads or measures spots, scores them, prints and writes tables."""

from __future__ import annotations

import shlex
import time
from collections import Counter
from collections.abc import Sequence
from itertools import chain
from pathlib import Path
from typing import Literal

import matplotlib
from rich.console import Console

from benchmarks.paper import VISIBLE_ENOUGH
from benchmarks.reporting import STYLE, write_page
from benchmarks.sets.read.stacks import Mode, stacks_of
from benchmarks.sets.score.entries import Entry, entries_in, entry_of
from benchmarks.sets.score.images import images_of
from benchmarks.sets.score.judging import Against, Outcome, Score, score
from benchmarks.sets.score.leaderboard import leaderboard
from benchmarks.sets.score.sample import sample_folder
from benchmarks.sets.score.spots_of_set import read_set_spots, track_set
from benchmarks.sets.score.views import tables
from benchmarks.study import versions, write_json
from estimator import Calibration, SpotRecord, read_calibration, write_spots
from estimator.files import fingerprint, in_utf8, require_space, written_whole
from estimator.run import progress
from optics import InputError

_SCHEMA = 1
_LEAST_BYTES = 2**18  # of the figures
_TRACKING = ("eyespot", "opencv-python-headless", "numpy")  # what the measured spots depend on


def run(
    folder: Path,
    spots_files: Sequence[Path],
    *,
    entries: Path | None = None,
    mode: Mode | Literal["both"] | None = None,
    calibration: Path | None = None,
    against: Against = "half_max",
    split: str | None = None,
    out: Path | None = None,
) -> None:
    """Score spots files, entries of a leaderboard and modes of our estimator on a set.

    Args:
        folder: a set or a stack.
        spots_files: see `read_set_spots`; the name of a file is the name of the estimator.
        entries: folder with entries, see `entries_in`.
        mode: mode of our estimator that measures the images first; "both" are the literal and the
            sub-pixel mode.
        calibration: of the beam, for the mode pixels; None for each stack's true one.
        against: which of the two ellipses is the truth.
        split: the only split to score; None: all splits.
        out: new folder for report.html with leaderboard.csv and leaderboard_by_condition.csv,
            score.json, score.csv, figures, and MODE.csv with the measured spots; None: only print
            the tables.

    Raises:
        InputError: the input is invalid, or `out` exists.
        OSError: `out` cannot be written.
    """
    folder = Path(folder)
    modes: tuple[Mode, ...] = ("literal", "subpixel")
    modes = modes if mode == "both" else (mode,) if mode else ()
    given = [entry_of(path) for path in spots_files] + (entries_in(entries) if entries else [])
    _check([*(entry.name for entry in given), *modes])
    if calibration is not None and mode != "pixels":
        raise InputError("calibration has no effect without --mode pixels. Give both, or neither.")
    beam = None if calibration is None else read_calibration(calibration)
    if out is None:
        _scored(folder, given, modes, beam, against, split)
        return
    with written_whole(out) as whole:
        whole.mkdir()
        require_space(out, _LEAST_BYTES)
        result, measured, found = _scored(folder, given, modes, beam, against, split)
        write_json(whole / "score.json", _summary(result, folder))
        result.table.to_csv(whole / "score.csv", index=False, lineterminator="\n")
        for name, records in measured.items():
            write_spots(whole / f"{name}.csv", records)
        words = ["eyespot", "score", folder, *spots_files]
        options = {"entries": entries, "mode": mode, "calibration": calibration, "split": split}
        options |= {"out": out}
        given_options = [[f"--{name}", value] for name, value in options.items() if value]
        words += [*chain(*given_options), "--against", against]
        with matplotlib.rc_context(STYLE):
            write_page(
                whole,
                leaderboard(result, found, name=in_utf8(folder.resolve().name)),
                command=shlex.join(map(str, words)),
                versions=versions(),
                summary_file="score.json",
            )
    print(f"Wrote {out / 'report.html'}.")


def _scored(
    folder: Path,
    given: Sequence[Entry],
    modes: Sequence[Mode],
    beam: Calibration | None,
    against: Against,
    split: str | None,
) -> tuple[Score, dict[str, list[SpotRecord]], dict[str, Entry]]:
    """Measure, score and print; returns also the measured spots by mode, and all entries."""
    stacks = stacks_of(folder)
    chosen = [entry for entry in stacks if split in (None, entry.split)]
    if not chosen:
        known = ", ".join(dict.fromkeys(entry.split for entry in stacks if entry.split))
        raise InputError(f"the set has no split {split}. It has: {known or 'no splits'}.")
    images = images_of(stacks)
    spots = {
        entry.name: read_set_spots(entry.spots, stacks, images.index)
        for entry in given
        if entry.spots
    }
    measured: dict[str, list[SpotRecord]] = {}
    found = {entry.name: entry for entry in given}
    scored = images if split is None else images[images.split == split]
    with progress("Tracking", total=len(scored) * len(modes)) as advance:
        for mode in modes:
            begin = time.perf_counter()
            measured[mode] = track_set(chosen, mode, calibration=beam, progress=advance)
            passed = time.perf_counter() - begin
            spots[mode] = {record.file_name: record for record in measured[mode]}
            found[mode] = _own_entry(mode, folder, 1000 * passed / len(scored))
    kept = {
        name: {image: record for image, record in records.items() if image in scored.index}
        for name, records in spots.items()
    }
    if empty := [name for name, records in kept.items() if not records]:
        raise InputError(f"{empty[0]} has no spots of the split {split}. Give another --split.")
    result = score(scored, kept, against=against)
    for table in tables(result):
        Console().print(table)
    return result, measured, found


def _own_entry(mode: Mode, folder: Path, ms_per_frame: float) -> Entry:
    """The entry of a mode of our estimator; the time includes the reading of the images."""
    return Entry(
        name=mode,
        command=f"eyespot score {_named(folder)} --mode {mode}",
        versions=", ".join(f"{name} {versions()[name]}" for name in _TRACKING),
        ms_per_frame=ms_per_frame,
    )


def _named(folder: Path) -> str:
    """How a command names a set; the path on this machine means nothing to others."""
    is_sample = folder.resolve() == sample_folder().resolve()
    return "--sample" if is_sample else in_utf8(folder.resolve().name)


def _check(names: Sequence[str]) -> None:
    if not names:
        raise InputError(
            "nothing to score. Give spots files, --entries, or --mode to measure the images."
        )
    if twice := [name for name, count in Counter(names).items() if count > 1]:
        raise InputError(f"two estimators have the name {twice[0]}. Rename one of the spots files.")


def _summary(result: Score, folder: Path) -> dict[str, object]:
    """Content of score.json."""
    manifest = folder / "manifest.json"
    keys = ["estimator", "condition", "group"]
    errors = {
        key: of.drop(columns=keys).to_dict("records") for key, of in result.errors.groupby(keys)
    }
    return {
        "schema": _SCHEMA,
        "set": folder.resolve().name,
        "manifest": fingerprint(manifest) if manifest.is_file() else None,
        "against": result.against,
        "visible_from_fraction": VISIBLE_ENOUGH,
        "outcomes": {name: Counter(judged.outcome) for name, judged in result.judged.items()},
        "reasons_of_misses": {
            name: Counter(judged.reason[judged.outcome == Outcome.MISSED])
            for name, judged in result.judged.items()
        },
        "left_out": result.left_out,
        "groups": [
            {**counts, "errors": errors.get(tuple(counts[key] for key in keys), [])}
            for counts in result.counts.to_dict("records")
        ],
        "versions": versions(),
    }
