"""The command `eyespot score`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from optics import InputError


def score(
    folder: Annotated[
        Path | None,
        typer.Argument(metavar="DIR", help="Labelled set or stack; not needed with --sample."),
    ] = None,
    spots: Annotated[
        list[Path] | None,
        typer.Argument(
            metavar="SPOTS…",
            help="Spots files with image names relative to DIR, or folders with SPLIT/STACK.csv.",
        ),
    ] = None,
    entries: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Folder of a leaderboard. Every spots file, and every folder with spots files, is "
            "an entry; see docs/leaderboard.md.",
        ),
    ] = None,
    mode: Annotated[
        Literal["literal", "subpixel", "pixels", "both"] | None,
        typer.Option(
            help="Also measure the images with our estimator, and score its spots; both: literal "
            "and subpixel."
        ),
    ] = None,
    calibration: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="The beam of --mode pixels, from `eyespot fit` (default: each stack's true one).",
        ),
    ] = None,
    sample: Annotated[
        bool,
        typer.Option(
            "--sample",
            help="Score on the small set that comes with eyespot: spots files, --mode, or our "
            "sub-pixel mode if no spots are given.",
        ),
    ] = False,
    against: Annotated[
        Literal["half_max", "cone"],
        typer.Option(
            help="True ellipse to compare with: the half-maximum contour, or the edge of the cone."
        ),
    ] = "half_max",
    split: Annotated[
        str | None,
        typer.Option(help="Score only this split, such as test (default: all that have spots)."),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Folder for the page report.html, tables and figures; it must not exist yet.",
        ),
    ] = None,
) -> None:
    """Compare an estimator's spots with the labels of a set."""
    from benchmarks.sets.score.sample import sample_folder
    from benchmarks.sets.score.scoring import run

    if sample:
        # The first argument is then a spots file, too.
        spots, folder = [*([folder] if folder else []), *(spots or [])], sample_folder()
        mode = mode or (None if spots or entries else "subpixel")
    if folder is None:
        raise InputError("DIR is missing: the set or stack to score on. Or give --sample.")
    run(
        folder,
        spots or [],
        entries=entries,
        mode=mode,
        calibration=calibration,
        against=against,
        split=split,
        out=out,
    )
