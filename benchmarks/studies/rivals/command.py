"""The command `eyespot study rivals`."""

from __future__ import annotations

from benchmarks.reporting import OutputFolder, Quick, Seed


def rivals(*, out: OutputFolder, quick: Quick = False, seed: Seed = None) -> None:
    """Read one distance from the spot, from the instrument's shadow and from a stereo pair.

    To continue a run that was stopped, start it again with the same folder.
    """
    from benchmarks.reporting import Request
    from benchmarks.studies.rivals.run import run

    run(Request(out=out, quick=quick, seed=seed))
