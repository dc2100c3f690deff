"""The command `eyespot fit`."""

import json
import shlex
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from eyespot.calibration.command.choices import Choices
from eyespot.estimator.run.options import OUT, OUTPUT, Rerun
from eyespot.formats.inputs import InputError
from eyespot.formats.whole_files import require_space, written_whole

_MAX_REPORT_BYTES = 2**23  # with its figures


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
        sources: Recordings of withdrawals, all with one microscope: stacks, folders of images,
            TIFFs, videos, ROS bags, or spots files.
        out: Calibration file (JSON) to write. The report is written beside it, as .html.
        overwrite: Replace both if they exist.
        rerun: Record frames, spots, distances and residuals of a good fit for the viewer rerun
            (.rrd), or show them in it at once.
        as_json: Print verdict and parameters as one JSON object.
    """
    from rich.console import Console

    from eyespot.calibration.command.fit_verdict import refusal
    from eyespot.calibration.command.fitting import (
        fit_recordings,
        opened_recordings,
        record_fit,
        table_of,
    )
    from eyespot.estimator.viewer import check_recording_path
    from eyespot.formats.calibration import write_calibration

    report = out.with_suffix(".html")
    if report == out:
        raise InputError(f"{out}: the report uses the ending .html. End the calibration in .json.")
    if rerun is not None:
        check_recording_path(rerun)
    # Entered before the fit, so that a name that is taken or a full disk does not cost its result.
    with written_whole(out, replace=overwrite) as partial:
        with written_whole(report, replace=overwrite) as page:
            require_space(out, _MAX_REPORT_BYTES)
            found = fit_recordings(opened_recordings(sources, choices), choices)
            if as_json:
                print(json.dumps(found.summary))
            else:
                Console().print(table_of(found.fitted, found.recordings))
            page.write_text(found.page(), encoding="utf-8", errors="backslashreplace")
        if not found.good:
            raise InputError(refusal(found.doubts, model=found.model, report=report))
        write_calibration(partial, found.calibration)
    if rerun is not None:
        record_fit(rerun, found)
    if as_json:
        return
    print(f"{found.verdict}. Wrote {out} and {report}.")
    rig = shlex.join([word for file in choices.rig[:1] for word in ("--rig", str(file))])
    words = f"--calibration {shlex.quote(str(out))}" + (f" {rig}" if rig else "")
    print(f"Next: eyespot track SOURCE {words} --out spots.csv")
