"""Runs benchmarks: `python -m benchmarks.bench [NAME ...] [--full]`."""

from __future__ import annotations

import importlib
from typing import Annotated

import typer

MAKE_BENCH = (
    "estimator.speed",
    "estimator.spotless",
    "estimator.stated_errors",
    "cone_fit",
    "image_fit",
    "frame_pose",
    "pixel_pose",
    "pixel_adverse",
    "viewing_speed",
    "load",
)
"""What `make bench` runs. Each module has a function `run(*, full: bool)` that prints tables,
some with a seed, too."""

BY_NAME_ONLY = (
    "lens_fit",
    "photon_fit",
    "estimator.tuning",
    "set_size",
    "pixel_branches",
    "pixel_memory",
)
"""Benches that take long."""

SEEDED = ("estimator.stated_errors",)
"""Benches whose frames follow from a seed."""

_SEED = 2026


def main(
    names: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[NAME ...]",
            help=f"Benches to run: {', '.join(MAKE_BENCH)} (default: all of these), "
            f"{' or '.join(BY_NAME_ONLY)}.",
        ),
    ] = None,
    full: Annotated[
        bool,
        typer.Option(
            "--full",
            help="Use more or larger frames in estimator.speed, estimator.spotless, "
            "estimator.stated_errors, image_fit, pixel_pose, pixel_adverse, pixel_branches, "
            "pixel_memory, load.",
        ),
    ] = False,
    seed: Annotated[
        int | None,
        typer.Option(min=0, help="Random seed of estimator.stated_errors (default: 2026)."),
    ] = None,
) -> None:
    """Measure speed and accuracy, each compared with alternatives, and print tables."""
    if unknown := set(names or ()) - {*MAKE_BENCH, *BY_NAME_ONLY}:
        raise typer.BadParameter(f"no such bench: {', '.join(sorted(unknown))}. See --help.")
    if seed is not None and not {*(names or MAKE_BENCH)} & {*SEEDED}:
        raise typer.BadParameter(f"--seed belongs to {', '.join(SEEDED)}.")
    for name in names or MAKE_BENCH:
        print(f"\n== {name}", flush=True)
        module = importlib.import_module(f"benchmarks.bench.{name}")
        if name in SEEDED:
            module.run(full=full, seed=_SEED if seed is None else seed)
        else:
            module.run(full=full)


if __name__ == "__main__":
    typer.run(main)
