"""The command `eyespot study dynamic`."""

from __future__ import annotations

from typing import Annotated

import typer

from benchmarks.reporting import Changes, LightSource, OutputFolder, Quick, Seed, StartingScene


def dynamic(
    out: OutputFolder,
    scene: StartingScene = None,
    changes: Changes = None,
    quick: Quick = False,
    seed: Seed = None,
    source: LightSource = "both",
    exposure_ms: Annotated[
        float,
        typer.Option(help="Exposure time of a frame at the mean distance.", min=0.1, max=100.0),
    ] = 20.0,
) -> None:
    """Measure the error while the tip moves: by speed, motion blur and a late pose.

    To continue a run that was stopped, start it again with the same folder.
    """
    from benchmarks.reporting import Request
    from benchmarks.studies.dynamic.run import run

    run(
        Request(
            out=out,
            scene=scene,
            changes=tuple(changes or ()),
            quick=quick,
            seed=seed,
            options={"source": source, "exposure-ms": exposure_ms},
        )
    )
