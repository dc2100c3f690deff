"""The command `eyespot study dynamic`."""

from __future__ import annotations

from typing import Annotated

from cyclopts import Parameter
from cyclopts.validators import Number

from benchmarks.reporting import Changes, LightSource, OutputFolder, Quick, Seed, StartingScene


def dynamic(
    scene: StartingScene = None,
    /,
    *,
    out: OutputFolder,
    changes: Changes = (),
    quick: Quick = False,
    seed: Seed = None,
    source: LightSource = "both",
    exposure_ms: Annotated[float, Parameter(validator=Number(gte=0.1, lte=100))] = 20.0,
) -> None:
    """Measure the error while the tip moves: by speed, motion blur and a late pose.

    To continue a run that was stopped, start it again with the same folder.

    Args:
        exposure_ms: Exposure time of a frame at the mean distance, 0.1 to 100.
    """
    from benchmarks.reporting import Request
    from benchmarks.studies.dynamic.run import run

    run(
        Request(
            out=out,
            scene=scene,
            changes=changes,
            quick=quick,
            seed=seed,
            options={"source": source, "exposure-ms": exposure_ms},
        )
    )
