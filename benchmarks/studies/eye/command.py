"""The command `eyespot study eye`."""

from __future__ import annotations

from benchmarks.reporting import OutputFolder, Quick, Seed


def eye(*, out: OutputFolder, quick: Quick = False, seed: Seed = None) -> None:
    """Look through contact and wide-field lenses into many eyes: the error of each model.

    Exact contours only; nothing is rendered. To repeat a run, start it again with a new folder.
    """
    from benchmarks.reporting import Request
    from benchmarks.studies.eye.run import run

    run(Request(out=out, quick=quick, seed=seed))
