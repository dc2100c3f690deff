"""`eyespot study dynamic`: the error of a distance while the tip moves, and what makes it.

DIR/dynamic_error.csv  one row a frame and latency: estimate, the robot's reading, the error's parts
    dynamic_spread.csv sizes of errors and parts by speed
    SOURCE-rest-literal-paper-exposure.csv  spots at rest that literal mode is calibrated with
    stacks/            every motion, and the same with exposures too short for blur
"""

from __future__ import annotations

import scenes
from benchmarks.reporting import Request, Study
from benchmarks.studies.dynamic import measure as dynamic_measure
from benchmarks.studies.dynamic.findings import COMPARED, DynamicError, DynamicFindings
from benchmarks.studies.dynamic.parts import spreads
from benchmarks.studies.dynamic.report import report
from benchmarks.studies.dynamic.trials import at_rest, sensitivity, trials
from scenes import Scene, SceneError

SPEEDS_MM_S = (0.5, 1.0, 1.5, 2.0, 3.0, 5.0)
_QUICK_SPEEDS_MM_S = (0.5, 1.5, 5.0)
_RUNS = 2

# A robot's stamps jitter; without, they would fall on the frames' own moments.
_DEFAULTS = ("clocks.kinematics_jitter_s=0.001",)


def run(request: Request) -> DynamicFindings:
    """Render, read, split and report.

    Args:
        request: the arguments; its option "source" is "cone", "lens" or "both", and
            "exposure-ms" the exposure at the mean distance; metered ones grow with the distance.

    Raises:
        SceneError: the wall is no eyeball, or the spot moves out of view.
        InputError: the folder has other files.
        RendererUnavailable: Mitsuba cannot run here.
    """
    study = Study("dynamic", request, defaults=_DEFAULTS, check=check)
    asked = str(request.options["source"])
    sources = ("cone", "lens") if asked == "both" else (asked,)
    speeds = _QUICK_SPEEDS_MM_S if request.quick else SPEEDS_MM_S
    rows = [
        row
        for source in sources
        for row in _rows(study, source, speeds=speeds, runs=1 if request.quick else _RUNS)
    ]
    findings = DynamicFindings(
        scene=study.scene,
        exposure_ms=float(request.options["exposure-ms"]),
        sources=sources,
        speeds=speeds,
        rows=rows,
        spreads=spreads(rows, speeds),
    )
    study.publish(report, findings)
    return findings


def check(scene: Scene) -> None:
    """Refuse a scene without an eyeball, which the models need.

    Raises:
        SceneError: saying what to change.
    """
    if scene.phantom.kind != "eyeball":
        raise SceneError(
            "the study's models are those of the eyeball; got phantom.kind "
            f"'{scene.phantom.kind}'. Set phantom.kind=eyeball."
        )


def _rows(study: Study, source: str, *, speeds: tuple[float, ...], runs: int) -> list[DynamicError]:
    scene = scenes.changed(study.scene, {"source.kind": source})
    exposure_s = float(study.request.options["exposure-ms"]) / 1000
    with study.timed(f"{source}: render at rest"):
        rest = study.stack(f"{source}-rest", at_rest(scene))
    wanted = [
        trial
        for way in COMPARED
        for run in range(1, runs + 1)
        for trial in trials(
            scene,
            way,
            sensitivity=sensitivity(rest, scene, way, exposure_s=exposure_s),
            speeds=speeds,
            run=run,
        )
    ]
    for trial in wanted:
        if trial.speed_mm_s == speeds[-1]:  # reaches furthest, so refuse it before rendering
            scenes.check_scene(trial.moving)
    with study.timed(f"{source}: render motions"):
        moving = study.stacks({trial.name: trial.moving for trial in wanted})
        frozen = study.stacks({f"{trial.name}-frozen": trial.frozen for trial in wanted})
    with study.timed(f"{source}: measure"):
        rangers = {
            way: dynamic_measure.ranger(
                rest, scene, way, spots_file=study.folder / f"{source}-rest-{way.slug}.csv"
            )
            for way in COMPARED
        }
        return [
            row
            for trial in wanted
            for row in dynamic_measure.errors(
                trial,
                moving=moving[trial.name],
                frozen=frozen[f"{trial.name}-frozen"],
                ranger=rangers[trial.way],
            )
        ]
