"""The command `eyespot fit`."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from calibration.command.choices import Choices
from estimator.run.options import OUT, OUTPUT, Rerun


def fit(
    *sources: Annotated[Path, Parameter(required=True)],
    out: Annotated[Path, OUT],
    choices: Choices = Choices(),
    overwrite: Annotated[bool, OUTPUT] = False,
    rerun: Rerun = None,
    as_json: Annotated[bool, OUTPUT, Parameter("--json")] = False,
) -> None:
    """Fit a model of the light beam to recordings and write a calibration file.

    A cone takes some ten seconds, a lens some minutes. The file serves `eyespot track
    --calibration`. A fit that fails its checks writes its report only, says why, and ends with exit
    code 2. If the model misses a small part of the light, the file is written with standard
    deviations that contain this misfit, and the misfit is described.

    Args:
        sources: Recordings of withdrawals from contact, all with one microscope: stacks, spots
            files or ROS bags.
        out: Calibration file (JSON) to write. The report is written beside it, as .html.
        overwrite: Replace both if they exist.
        rerun: Record frames, spots, distances and residuals of a good fit for the viewer rerun
            (.rrd), or show them in it at once.
        as_json: Print verdict and parameters as one JSON object.
    """
    from calibration.command.fitting import run

    run(sources, out, choices, rerun, overwrite=overwrite, as_json=as_json)
