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
            help="Spots files whose image names start at DIR, or folders of SPLIT/STACK.csv.",
        ),
    ] = None,
    mode: Annotated[
        Literal["literal", "subpixel", "both"] | None,
        typer.Option(help="Measure the images with our estimator, too, and score its spots."),
    ] = None,
    against: Annotated[
        Literal["half_max", "cone"],
        typer.Option(
            help="True ellipse to compare with: the half-maximum contour, or the ideal cone's edge."
        ),
    ] = "half_max",
    out: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Folder for tables and figure; must not exist."),
    ] = None,
) -> None:
    """Measure how good an estimator's spots are on a labelled set."""
    from benchmarks.sets.score.scoring import run

    run(folder, spots or [], mode=mode, against=against, out=out)
