"""The command `eyespot study static`."""

from __future__ import annotations

from benchmarks.reporting import Changes, OutputFolder, Quick, Seed, StartingScene


def static(
    scene: StartingScene = None,
    /,
    *,
    out: OutputFolder,
    changes: Changes = (),
    quick: Quick = False,
    seed: Seed = None,
) -> None:
    """Repeat the paper's Tables I and II many times, and split their error by cause.

    To continue a run that was stopped, start it again with the same folder.
    """
    from benchmarks.reporting import Request
    from benchmarks.studies.static.run import run

    run(Request(out=out, scene=scene, changes=changes, quick=quick, seed=seed))
