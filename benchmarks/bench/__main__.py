"""Runs benchmarks: `python -m benchmarks.bench [NAME ...] [--full]`."""

from __future__ import annotations

import importlib
from typing import Annotated

import typer

MAKE_BENCH = (
    "geometry_speed",
    "render_speed",
    "render_efficiency",
    "estimator.accuracy",
    "fit_speed",
    "cone_fit",
    "image_fit",
    "frame_pose",
    "pixel_pose",
    "study_speed",
    "viewing_speed",
    "dataset_speed",
    "load",
)
"""What `make bench` runs. Each module has a function `run(*, full: bool)` that prints tables."""

BY_NAME_ONLY = ("lens_fit", "photon_fit", "estimator.tuning", "set_size")
"""Benches that take long, and whose results the documents do not state."""


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
            help="Use more or larger frames in render_speed, estimator.accuracy, image_fit, "
            "pixel_pose, load.",
        ),
    ] = False,
) -> None:
    """Measure speed and accuracy, each compared with alternatives, and print tables."""
    if unknown := set(names or ()) - {*MAKE_BENCH, *BY_NAME_ONLY}:
        raise typer.BadParameter(f"no such bench: {', '.join(sorted(unknown))}. See --help.")
    for name in names or MAKE_BENCH:
        print(f"\n== {name}", flush=True)
        importlib.import_module(f"benchmarks.bench.{name}").run(full=full)


if __name__ == "__main__":
    typer.run(main)
