"""The command `eyespot score`: measures, judges, writes and prints."""

import shlex
import time
from collections import Counter
from collections.abc import Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import Annotated, Any, Literal

import matplotlib
import pandas as pd
from cyclopts import Parameter

from eyespot.benchmarks.paper import VISIBLE_ENOUGH
from eyespot.benchmarks.reporting import STYLE, grouped, where, write_page
from eyespot.benchmarks.run_folder import versions, write_json
from eyespot.benchmarks.sets.read import Mode, SetStack, check_unchanged, stacks_of
from eyespot.benchmarks.sets.score import judging
from eyespot.benchmarks.sets.score import scored_spots as spots_of_set
from eyespot.benchmarks.sets.score.judging import ALL, MAIN, Against, Outcome, Score
from eyespot.benchmarks.sets.score.leaderboard_page import leaderboard, number_text, with_intervals
from eyespot.benchmarks.sets.score.scored_spots import ScoredEstimator, sample_folder
from eyespot.estimator.run.options import OUT
from eyespot.estimator.run.progress_bar import progress, say
from eyespot.formats.calibration import read_calibration
from eyespot.formats.inputs import InputError, in_utf8
from eyespot.formats.manifest import fingerprint
from eyespot.formats.spots import SpotRecord, write_spots
from eyespot.formats.whole_files import require_space, written_whole

_SCHEMA = 2
_LEAST_BYTES = 2**18  # The figures need about as much.
_TRACKING_PACKAGES = ("eyespot", "opencv-python-headless", "numpy")
_MOST_ESTIMATORS = 4  # More would make the last table too wide.

Spots = dict[str, dict[str, SpotRecord]]
"""Each estimator's records by image name, by the estimator's name."""


def score(
    folder: Path | None = None,
    spots: tuple[Path, ...] = (),
    /,
    *,
    entries: Path | None = None,
    mode: Literal["auto", "literal", "subpixel", "pixels", "both"] | None = None,
    calibration: Path | None = None,
    sample: bool = False,
    unrelated: Annotated[bool | None, Parameter(negative="--sequence")] = None,
    against: Literal["half_max", "cone"] = "half_max",
    split: str | None = None,
    out: Annotated[Path | None, OUT] = None,
    as_json: Annotated[bool, Parameter("--json")] = False,
) -> Score:
    """Compare an estimator's spots with the labels of a set.

    Args:
        folder: Labelled set or stack; not needed with --sample.
        spots: Spots files with image names relative to the set, or folders with SPLIT/STACK.csv.
        entries: Folder of a leaderboard. Every spots file, and every folder with spots files, is an
            entry; see docs/leaderboard.md.
        mode: Also measure the images with our estimator, and score its spots; both: literal and
            subpixel; auto: as `eyespot track` (default: auto if no spots are given).
        calibration: The beam of the modes auto and pixels, from `eyespot fit` (default: each
            stack's true one).
        sample: Score on the small set that comes with eyespot.
        unrelated: Let --mode measure each image alone (default: if most true spots of a stack lie
            too far from the one before to be followed).
        against: True ellipse to compare with: the half-maximum contour, or the edge of the cone.
        split: Score only this split, such as test (default: all that have spots).
        out: Folder for the page report.html, tables and figures; it must not exist yet.
        as_json: Print the rows of score.csv as JSON.

    Raises:
        InputError: the input is invalid, or `out` exists.
        OSError: `out` cannot be written.
    """
    if sample:
        # The first argument is then a spots file, too.
        spots, folder = (*([folder] if folder else []), *spots), sample_folder()
    if folder is None:
        raise InputError("FOLDER is missing: the set or stack to score on. Or give --sample.")
    if mode is None and not spots and entries is None:
        mode = "auto"
    modes: tuple[Mode, ...] = ("literal", "subpixel")
    modes = modes if mode == "both" else (mode,) if mode else ()
    given = [spots_of_set.entry_of(path) for path in spots]
    given += spots_of_set.entries_in(entries) if entries else []
    names = Counter([*(entry.name for entry in given), *modes])
    if twice := [name for name, count in names.items() if count > 1]:
        raise InputError(f"two estimators have the name {twice[0]}. Rename one of the spots files.")
    if calibration is not None and mode not in ("auto", "pixels"):
        raise InputError("calibration has no effect without --mode auto or pixels. Give both.")
    with nullcontext() if out is None else written_whole(out) as whole:
        if out is not None and whole is not None:
            whole.mkdir()
            require_space(out, _LEAST_BYTES)
        stacks = stacks_of(folder)
        check_unchanged(stacks)
        chosen = [entry for entry in stacks if split in (None, entry.split)]
        if not chosen:
            known = ", ".join(dict.fromkeys(entry.split for entry in stacks if entry.split))
            raise InputError(f"the set has no split {split}. It has: {known or 'no splits'}.")
        images = judging.images_of(stacks)
        images_of_split = images if split is None else images[images.split == split]
        read = {
            entry.name: spots_of_set.read_set_spots(entry.spots, stacks, images.index)
            for entry in given
            if entry.spots
        }
        beam = None if calibration is None else read_calibration(calibration)
        with progress("Tracking", total=len(images_of_split) * len(modes)) as advance:
            about = {"calibration": beam, "unrelated": unrelated, "progress": advance}
            own, measured = measure(folder, chosen, modes, **about)
        result = judge(images_of_split, read | measured, against=against, split=split)
        if whole is not None:
            words: list[object] = ["eyespot", "score", folder, *spots]
            if unrelated is not None:
                words.append("--unrelated" if unrelated else "--sequence")
            for option, value in (
                *(("entries", entries), ("mode", mode), ("calibration", calibration)),
                *(("split", split), ("out", out), ("against", against)),
            ):
                words += [f"--{option}", value] if value else []
            command = shlex.join(map(str, words))
            write(whole, result, [*given, *own], measured, chosen, folder=folder, command=command)
    if out is not None:
        say(f"Wrote {out / 'report.html'}.", result=True)
    if as_json:
        say(result.table.to_json(orient="records", double_precision=15), result=True)
        return result
    for title, table in tables(result).items():
        say(f"{title}\n{table.to_string(index=False, na_rep='')}\n", result=True)
    if (result.judged.reason == "ambiguous").any():
        hint = "After a jump a spot is ambiguous; --unrelated measures each image by itself."
        say(hint, result=True)
    return result


def measure(
    folder: Path, stacks: Sequence[SetStack], modes: Sequence[Mode], **options: Any
) -> tuple[list[ScoredEstimator], Spots]:
    """Our modes as entries, and their spots in the stacks; options of `track_set`."""
    # A path on this machine means nothing to others.
    is_sample = folder.resolve() == sample_folder().resolve()
    name = "--sample" if is_sample else in_utf8(folder.resolve().name)
    used = ", ".join(f"{package} {versions()[package]}" for package in _TRACKING_PACKAGES)
    entries = []
    spots: Spots = {}
    for mode in modes:
        begin = time.perf_counter()
        records = spots_of_set.track_set(stacks, mode, **options)
        passed = time.perf_counter() - begin
        entry = ScoredEstimator(
            name=mode,
            command=f"eyespot score {name} --mode {mode}",
            versions=used,
            ms_per_frame=1000 * passed / len(records),  # with the reading of the images
        )
        entries.append(entry)
        spots[mode] = {record.file_name: record for record in records}
    return entries, spots


def judge(images: pd.DataFrame, spots: Spots, *, against: Against, split: str | None) -> Score:
    """Score the spots in the images, which are those of the split; InputError if one has none."""
    kept = {
        name: {image: record for image, record in records.items() if image in images.index}
        for name, records in spots.items()
    }
    if empty := [name for name, records in kept.items() if not records]:
        raise InputError(f"{empty[0]} has no spots of the split {split}. Give another --split.")
    return judging.score(images, kept, against=against)


def write(
    out: Path,
    result: Score,
    entries: Sequence[ScoredEstimator],
    measured: Spots,
    stacks: Sequence[SetStack],
    *,
    folder: Path,
    command: str,
) -> None:
    """Write the page of a score with its figures and tables, and MODE.csv of measured spots."""
    for mode, records in measured.items():
        write_spots(out / f"{mode}.csv", list(records.values()))
    manifest = folder / "manifest.json"
    outcomes = grouped(result.judged, "estimator")
    summary = {
        "schema": _SCHEMA,
        "set": folder.resolve().name,
        "manifest": fingerprint(manifest) if manifest.is_file() else None,
        "against": result.against,
        "visible_from_fraction": VISIBLE_ENOUGH,
        "outcomes": {name: own.outcome.value_counts().to_dict() for name, own in outcomes},
        "reasons_of_misses": {n: {} for n in result.left_out} | reasons_of_misses(result),
        "left_out": result.left_out,
        "versions": versions(),
    }
    write_json(out / "score.json", summary)
    result.table.to_csv(out / "score.csv", index=False, lineterminator="\n")
    with matplotlib.rc_context(STYLE):
        write_page(
            out,
            leaderboard(result, entries, name=in_utf8(folder.resolve().name), stacks=stacks),
            command=command,
            versions=versions(),
            summary_file="score.json",
        )


def tables(result: Score) -> dict[str, pd.DataFrame]:
    """Outcomes and errors of all images, calibration of σ, and the main quantity by condition.

    By title. The last table is left out if there are too many estimators; the page has it.
    """
    images = result.counts[result.counts.condition == ALL]
    why = dict.fromkeys(result.left_out, "")
    for name, counts in reasons_of_misses(result).items():
        said = (f"{n} {str(reason).replace('_', ' ')}" for reason, n in counts.items())
        why[name] = ", ".join(said)
    images = images.drop(columns=["condition", "group"]).assign(
        left_out=images.estimator.map(result.left_out),
        why_missed=images.estimator.map(why),
    )
    images = images.rename(columns={"visible": "spot visible", "glimpsed": "reported if hidden"})
    errors = result.errors[result.errors.condition == ALL]
    sizes = errors[["estimator", "quantity", "n"]].assign(
        bias=[number_text(value, "+.3f", none="") for value in errors.bias],
        RMSE=with_intervals(errors, "rmse", ".3f"),
        median=[number_text(value, ".3f") for value in errors.median_abs],
        largest=[number_text(value, ".3f") for value in errors.max_abs],
    )
    stated = errors[errors.n_sigma > 1]
    sigmas = stated[["estimator", "quantity"]].assign(
        n=stated.n_sigma,
        mean=[number_text(value, "+.2f") for value in stated.z_mean],
        spread=[number_text(value, ".2f") for value in stated.z_std],
        within_σ=with_intervals(stated, "within_1_sigma", ".2f"),
        within_2σ=with_intervals(stated, "within_2_sigma", ".2f"),
    )
    found = {
        "Images": images,
        f"Errors of the found spots ({result.against}), with 95 % intervals in brackets": sizes,
        "Errors divided by the estimator's σ; ideal: 0 ± 1, 0.68, 0.95": sigmas,
    }
    if len(images) <= _MOST_ESTIMATORS:
        here = result.by_condition
        missed = here.missed.astype(str) + " of " + here.visible.astype(str)
        rows = here[["condition", "group"]].assign(estimator=here.estimator, missed=missed)
        rows["RMSE"] = with_intervals(here, "rmse", ".3f")
        found[f"RMSE of {MAIN}, and missed images"] = rows
    return {title: frame for title, frame in found.items() if len(frame)}


def reasons_of_misses(result: Score) -> dict[str, dict[str, int]]:
    """How many visible spots each estimator missed, by its reason, the most frequent first."""
    missed = where(result.judged, outcome=Outcome.MISSED)
    reasons = {str(name): of.reason for name, of in grouped(missed, "estimator")}
    return {name: dict(Counter(own).most_common()) for name, own in reasons.items()}
