"""The commands `eyespot preregister` and `eyespot adjudicate`."""

import json
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from estimator.run.options import OUT
from formats.inputs import InputError
from scenes.commands import Changes, SceneFile

_POOR = 10.0
"""Times the noise. A wall's texture moves spots by some times their noise, another lens by more."""


def preregister(
    scene: SceneFile,
    /,
    *,
    out: Annotated[Path, OUT],
    uncertain: Annotated[tuple[str, ...], Parameter(metavar="KEY=SIGMA", show_default=False)] = (),
    changes: Changes = (),
    calibration: Path | None = None,
    model: str | None = None,
) -> None:
    """Write down what an experiment will measure, with intervals, before it is done.

    The SHA-256 that is printed proves later that the plan was not changed: publish it.

    Args:
        out: Plan to write (JSON); must not exist.
        uncertain: Standard uncertainty of a number in the scene, for example phantom.radius_mm=0.2.
            Repeatable.
        calibration: Calibration file with which distances will be read.
        model: Distance model (default: the calibration file's).
    """
    from benchmarks.predictions.plan import predicted
    from estimator.run.progress_bar import progress
    from formats.whole_files import refuse_existing, write_text
    from scenes import load_scene
    from scenes.world.motion import frame_count

    refuse_existing(out)
    if model is not None and calibration is None:
        raise InputError("model has no effect without calibration. Give both, or neither.")
    settings, sigmas = load_scene(scene, changes), {}
    for text in uncertain:
        key, _, sigma = (part.strip() for part in text.partition("="))
        try:
            sigmas[key] = float(sigma)
        except ValueError:
            raise InputError(
                f"--uncertain must be KEY=SIGMA, such as phantom.radius_mm=0.2; got {text!r}."
            ) from None
    with progress("Rehearsing", total=frame_count(settings)) as advance:
        plan = predicted(settings, sigmas, calibration=calibration, model=model, progress=advance)
    write_text(out, plan.model_dump_json(by_alias=True) + "\n")
    print(f"Wrote {out}: {len(plan.times_s)} frames.\nSHA-256 {plan.sha256}")


def adjudicate(
    plan: Path,
    source: str,
    /,
    *,
    poses: Path | None = None,
    eye_from_robot: Annotated[
        str, Parameter(metavar="QX,QY,QZ,QW", allow_leading_hyphen=True)
    ] = "0,0,0,1",
    microscope: Path | None = None,
    start_s: Annotated[float, Parameter("--begin")] = 0.0,
    as_json: Annotated[bool, Parameter("--json")] = False,
) -> None:
    """Say which predictions of a plan held, and what explains those that did not.

    Args:
        plan: File of `eyespot preregister`.
        source: Stack, folder of images, TIFF, video, or ROS bag.
        poses: Robot poses (CSV or ROS bag), on the clock of SOURCE (default: the stack's).
        eye_from_robot: Rotation from the poses' frame to the eye's, for the models exact and area.
        microscope: Microscope file of SOURCE (default: the stack's).
        start_s: Time in SOURCE at which the planned motion begins.
        as_json: Print the result as one JSON object, and nothing else.
    """
    from benchmarks.predictions.plan import judged, measured_as_planned, read_plan
    from benchmarks.reporting import rows_of

    agreed = read_plan(plan)
    given: dict[str, Any] = {"poses": poses, "microscope": microscope, "start_s": start_s}
    found = judged(
        agreed, measured_as_planned(agreed, source, eye_from_robot=eye_from_robot, **given)
    )
    if as_json:
        content = {
            "plan_sha256": agreed.sha256,
            "held": found.hits,
            "predictions": found.predictions,
            "quantities": found.tallies.to_dict("records"),
            "keys": found.causes.to_dict("records"),
            "misfit": found.misfit,
            "no_spot": dict(found.no_spot),
        }
        print(json.dumps(content))
        return
    names = {"hits": "held", "misses": "missed", "unmeasured": "of these not measured"}
    table = found.tallies.rename(columns=names | {"rms": "RMS deviation, σ"})
    share = found.hits / found.predictions
    lines = [
        f"Plan {plan}, SHA-256 {agreed.sha256}",
        table.to_string(index=False, float_format="{:.2f}".format),
        f"{found.hits} of {found.predictions} predictions held ({100 * share:.1f} %).",
    ]
    wrong = found.causes[found.causes.contradicts]
    for cause in rows_of(wrong):
        lines.append(
            f"Contradicted: {cause.key} was stated as {cause.stated:.6g} ± "
            f"{cause.stated_sigma:.2g}; the recording says {cause.found:.6g} ± "
            f"{cause.found_sigma:.2g}, {abs(cause.pull):.1f} σ apart."
        )
    if len(wrong) > 1:
        lines.append("If one of these is corrected, the others may agree. Begin with the first.")
    if found.misfit > _POOR:
        best = "With the best values of all keys" if len(wrong) else "Whatever the stated keys are,"
        lines.append(
            f"{best} {found.misfit:.0f} times the noise remains: the plan is linear in its keys, "
            "or something differs that it takes as certain."
        )
    elif wrong.empty:
        lines.append("Nothing that was stated is contradicted.")
    if found.no_spot:
        reasons = ", ".join(f"{n} {reason}" for reason, n in found.no_spot.most_common())
        lines.append(f"Frames without a spot: {reasons}.")
    print(*lines, sep="\n")
