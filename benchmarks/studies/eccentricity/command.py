"""The command `eyespot study eccentricity`."""

from __future__ import annotations

from typing import Annotated

import typer

from benchmarks.reporting import Changes, OutputFolder, Quick, Seed, StartingScene

_GEOMETRIES, _GEOMETRIES_IF_QUICK = 1 << 17, 1 << 14


def eccentricity(
    out: OutputFolder,
    scene: StartingScene = None,
    changes: Changes = None,
    quick: Quick = False,
    seed: Seed = None,
    geometries: Annotated[
        int | None,
        typer.Option(
            help="Number of random geometries (default: "
            f"{_GEOMETRIES}; {_GEOMETRIES_IF_QUICK} if quick).",
            min=1,
        ),
    ] = None,
) -> None:
    """Measure how wrong each model is, at which eccentricity, and by which cause.

    To continue a run that was stopped, start it again with the same folder.
    """
    from benchmarks.reporting import Request
    from benchmarks.studies.eccentricity.run import run

    count = geometries or (_GEOMETRIES_IF_QUICK if quick else _GEOMETRIES)
    run(
        Request(
            out=out,
            scene=scene,
            changes=tuple(changes or ()),
            quick=quick,
            seed=seed,
            options={"geometries": count},
        )
    )
