"""The command `eyespot validate`."""

from __future__ import annotations

from typing import Annotated

import typer

from benchmarks.reporting import LightSource, OutputFolder, Quick


def validate(
    out: OutputFolder,
    quick: Quick = False,
    seed: Annotated[int, typer.Option(help="Random seed of noise and wall texture.", min=0)] = 0,
    source: LightSource = "both",
) -> None:
    """Repeat the paper's static experiment on rendered images and write a report.

    To continue a run that was stopped, start it again with the same folder.
    """
    from benchmarks.studies.validate.run import run

    run(out=out, quick=quick, seed=seed, source=source)
