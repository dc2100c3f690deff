"""The command `eyespot study pose`."""

from __future__ import annotations

from benchmarks.reporting import Changes, OutputFolder, Quick, Seed, StartingScene


def pose(
    scene: StartingScene = None,
    /,
    *,
    out: OutputFolder,
    changes: Changes = (),
    quick: Quick = False,
    seed: Seed = None,
) -> None:
    """Estimate the tool's tip and axis from one spot and from three, beside their bounds.

    To continue a run that was stopped, start it again with the same folder.
    """
    from benchmarks.reporting import Request
    from benchmarks.studies.pose.run import run

    run(Request(out=out, scene=scene, changes=changes, quick=quick, seed=seed))
