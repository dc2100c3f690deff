"""The command `eyespot score`."""

from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from estimator.run.options import OUT
from formats.inputs import InputError


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
) -> None:
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
    """
    from benchmarks.sets.score.pages import run, tables
    from benchmarks.sets.score.spots import sample_folder

    if sample:
        # The first argument is then a spots file, too.
        spots, folder = (*([folder] if folder else []), *spots), sample_folder()
    if folder is None:
        raise InputError("FOLDER is missing: the set or stack to score on. Or give --sample.")
    result = run(
        folder,
        spots,
        entries=entries,
        mode=mode,
        calibration=calibration,
        unrelated=unrelated,
        against=against,
        split=split,
        out=out,
    )
    if as_json:
        print(result.table.to_json(orient="records", double_precision=15))
        return
    for title, table in tables(result).items():
        print(title, table.to_string(index=False, na_rep=""), sep="\n", end="\n\n")
    if any((of.reason == "ambiguous").any() for of in result.judged.values()):
        print("After a jump a spot is ambiguous; --unrelated measures each image by itself.")
