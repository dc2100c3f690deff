"""The command `eyespot study medium`."""

from __future__ import annotations

from benchmarks.reporting import Changes, OutputFolder, Quick, Seed, StartingScene


def medium(
    scene: StartingScene = None,
    /,
    *,
    out: OutputFolder,
    changes: Changes = (),
    quick: Quick = False,
    seed: Seed = None,
) -> None:
    """Calibrate in air, measure in vitreous: the error, and how much the lens model corrects.

    To continue a run that was stopped, start it again with the same folder.
    """
    from benchmarks.reporting import Request
    from benchmarks.studies.medium.run import run

    run(Request(out=out, scene=scene, changes=changes, quick=quick, seed=seed))
