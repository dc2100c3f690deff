"""The commands `eyespot rivals run`, `eyespot rivals tune` and `eyespot rivals train`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

Folder = Annotated[Path, typer.Argument(metavar="SET", help="Labelled set.")]
Names = Annotated[
    list[str] | None,
    typer.Option("--entry", help="Name of an entry; may be repeated (default: all entries)."),
]
Workers = Annotated[
    int | None,
    typer.Option(help="Worker processes on this machine (default: one per core).", min=1),
]


def run(
    folder: Folder,
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder of the entries; it is new.")],
    names: Names = None,
    splits: Annotated[
        list[str] | None,
        typer.Option("--split", help="Split to measure; may be repeated (default: all splits)."),
    ] = None,
    constants: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="File of `rivals tune` (default: eyespot's own)."),
    ] = None,
    weights: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="File of `rivals train` (default: eyespot's own)."),
    ] = None,
    workers: Workers = None,
) -> None:
    """Measure the images of a set with all entries: other software, a network, our modes.

    `eyespot score SET --entries DIR` then ranks them.
    """
    from benchmarks.rivals.entries import chosen
    from benchmarks.rivals.learned import WEIGHTS
    from benchmarks.rivals.running import CONSTANTS, run_entries
    from benchmarks.sets.make import cores

    run_entries(
        folder,
        out,
        entries=chosen(names or []),
        splits=splits or [],
        constants=constants or CONSTANTS,
        weights=weights or WEIGHTS,
        workers=workers or cores(),
    )


def tune(
    folder: Folder,
    out: Annotated[Path, typer.Option(metavar="FILE", help="New JSON file.")],
    names: Names = None,
    every: Annotated[int, typer.Option(help="Use one stack of so many.", min=1)] = 1,
    workers: Workers = None,
) -> None:
    """Choose the free constants of the entries on the split train of a set."""
    from benchmarks.rivals.entries import chosen
    from benchmarks.rivals.tuning import tune as choose
    from benchmarks.sets.make import cores

    choose(folder, out, entries=chosen(names or []), every=every, workers=workers or cores())


def train(
    folder: Folder,
    out: Annotated[
        Path,
        typer.Option(
            metavar="DIR", help="Folder of the weights; a training that it holds is continued."
        ),
    ],
    epochs: Annotated[
        int, typer.Option(help="Number of epochs, along which the learning rate falls to 0.", min=1)
    ] = 40,
    stop: Annotated[
        int | None,
        typer.Option(help="Stop after so many epochs (default: all).", min=1),
    ] = None,
    seed: Annotated[int, typer.Option(help="Random seed.", min=0)] = 0,
) -> None:
    """Train the learned estimator on the split train, and calibrate it on validation.

    If a run was stopped, the same command continues it after its last epoch.
    """
    from benchmarks.rivals.learned import make_weights

    make_weights(folder, out, epochs=epochs, stop=stop or epochs, seed=seed)
