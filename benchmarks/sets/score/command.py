"""The command `eyespot score`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer


def score(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Labelled set or stack.")],
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
        Literal["literal", "subpixel", "both"] | None,
        typer.Option(help="Also measure the images with our estimator, and score its spots."),
    ] = None,
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
    from benchmarks.sets.score.scoring import run

    run(folder, spots or [], entries=entries, mode=mode, against=against, split=split, out=out)
