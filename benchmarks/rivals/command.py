"""The commands `eyespot rivals run`, `eyespot rivals tune` and `eyespot rivals train`."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter
from cyclopts.types import NonNegativeInt, PositiveInt

from estimator.run.options import OUT

Names = Annotated[
    tuple[str, ...],
    Parameter(
        "--entry",
        help="Name of an entry; may be repeated (default: all entries).",
        show_default=False,
    ),
]


def run(
    folder: Path,
    /,
    *,
    out: Annotated[Path, OUT],
    names: Names = (),
    splits: Annotated[tuple[str, ...], Parameter("--split", show_default=False)] = (),
    constants: Path | None = None,
    weights: Path | None = None,
    workers: PositiveInt | None = None,
) -> None:
    """Measure the images of a set with all entries: other software, a network, our modes.

    `eyespot score SET --entries OUT` then ranks them.

    Args:
        folder: Labelled set.
        out: Folder of the entries; it is new.
        splits: Split to measure; may be repeated (default: all splits).
        constants: File of `rivals tune` (default: eyespot's own).
        weights: File of `rivals train` (default: eyespot's own).
        workers: Worker processes on this machine (default: one per core).
    """
    from benchmarks.rivals.running import run_entries

    files = {"constants": constants, "weights": weights}
    run_entries(folder, out, names=names, splits=splits, workers=workers, **files)


def tune(
    folder: Path,
    /,
    *,
    out: Annotated[Path, OUT],
    names: Names = (),
    every: PositiveInt = 1,
    workers: PositiveInt | None = None,
) -> None:
    """Choose the free constants of the entries on the split train of a set.

    Args:
        folder: Labelled set.
        out: New JSON file.
        every: Use one stack of so many.
        workers: Worker processes on this machine (default: one per core).
    """
    from benchmarks.rivals.running import tune as choose

    choose(folder, out, names=names, every=every, workers=workers)


def train(
    folder: Path,
    /,
    *,
    out: Annotated[Path, OUT],
    epochs: PositiveInt = 40,
    seed: NonNegativeInt = 0,
) -> None:
    """Train the learned estimator on the split train, and calibrate it on validation.

    If a run was stopped, the same command continues it after its last epoch.

    Args:
        folder: Labelled set.
        out: Folder of the weights; a training that it holds is continued.
        epochs: Number of epochs, along which the learning rate falls to 0.
        seed: Random seed.
    """
    from benchmarks.rivals.learned.training import make_weights

    make_weights(folder, out, epochs=epochs, seed=seed)
