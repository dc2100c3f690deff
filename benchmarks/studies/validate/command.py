"""The command `eyespot validate`."""

from __future__ import annotations

from cyclopts.types import NonNegativeInt

from benchmarks.reporting import LightSource, OutputFolder, Quick


def validate(
    *,
    out: OutputFolder,
    quick: Quick = False,
    seed: NonNegativeInt = 0,
    source: LightSource = "both",
) -> None:
    """Repeat the paper's static experiment on rendered images and write a report.

    To continue a run that was stopped, start it again with the same folder.

    Args:
        seed: Random seed of noise and wall texture.
    """
    from benchmarks.studies.validate.run import run

    run(out=out, quick=quick, seed=seed, source=source)
