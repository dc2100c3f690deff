"""The command `eyespot study medium`."""

from __future__ import annotations

from benchmarks.reporting import Changes, OutputFolder, Quick, Seed, StartingScene


def medium(
    out: OutputFolder,
    scene: StartingScene = None,
    changes: Changes = None,
    quick: Quick = False,
    seed: Seed = None,
) -> None:
    """Calibrate in air, measure in vitreous: the error, and how much the lens model corrects.

    A run that was stopped continues where it was if it gets the same folder.
    """
    from benchmarks.reporting import Request
    from benchmarks.studies.medium.run import run

    run(Request(out=out, scene=scene, changes=tuple(changes or ()), quick=quick, seed=seed))
