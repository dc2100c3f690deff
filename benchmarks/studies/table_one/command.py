"""The command `eyespot study table-one`."""

from __future__ import annotations

from benchmarks.reporting import Changes, OutputFolder, Quick, Seed, StartingScene


def table_one(
    scene: StartingScene = None,
    /,
    *,
    out: OutputFolder,
    changes: Changes = (),
    quick: Quick = False,
    seed: Seed = None,
) -> None:
    """Find the lenses that give the paper's Table I, and why its trials differ.

    To continue a run that was stopped, start it again with the same folder.
    """
    from benchmarks.reporting import Request
    from benchmarks.studies.table_one.run import run

    run(Request(out=out, scene=scene, changes=changes, quick=quick, seed=seed))
