"""`eyespot study eccentricity`: how wrong each model is, where, and by which cause.

DIR/model_error.csv  every error of every model, analytic and rendered
    limits.csv       at which c a model's error reaches 0.1 and 0.5 mm
    refit.csv        c fitted as the paper does, and how much of the error that hides
    causes.csv       Shapley's share of each cause
    space.csv, sensitivity.csv  errors over the whole space, and which axis they come from
    stacks/, spots/  rendered frames, and the spots measured in them
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np

import scenes
from benchmarks.evaluation import ModelError, geometry_of, require_roomy_eyeball
from benchmarks.reporting import Request, Study
from benchmarks.studies.eccentricity import limits, rendered, space
from benchmarks.studies.eccentricity.findings import (
    LARGEST_C_MM,
    LIMITS_MM,
    EccentricityFindings,
    Withdrawals,
    pinhole_heights,
)
from benchmarks.studies.eccentricity.report import report
from benchmarks.studies.eccentricity.space import Space
from estimator.files import written_whole
from scenes import Scene


def run(request: Request) -> EccentricityFindings:
    """Compute, render, compare and report.

    Args:
        request: the arguments; its option "geometries" is their number in the space.

    Raises:
        SceneError: the wall is no eyeball, or too small.
        InputError: the folder has other files.
        RendererUnavailable: Mitsuba cannot run here.
    """
    study = Study("eccentricity", request, defaults=("source.kind=cone",), check=check)
    scene = study.scene
    with study.timed("render and measure"):
        found = rendered.measure(study, _trials(scene, quick=request.quick))
    with study.timed("withdrawals on exact contours"):
        exact = _withdrawals(scene, quick=request.quick)
    rows = [e for w in exact.values() for e in w.errors] + found.errors
    with study.timed("space of geometries"):
        filled = fill_space(
            scene,
            count=int(request.options["geometries"]),
            seed=study.seed,
            csv_file=study.folder / "model_error.csv",
            before=rows,
        )
    findings = EccentricityFindings(
        scene=scene,
        withdrawals=exact,
        limits=limits.limits([e for w in exact.values() for e in w.errors]),
        rendered=found,
        geometries=filled.count,
        spreads=filled.spreads(),
        sensitivities=filled.sensitivities(),
        within=filled.within(LIMITS_MM[-1]),
    )
    study.publish(report, findings)
    return findings


def check(scene: Scene) -> None:
    """Refuse a scene in which c cannot reach its largest value.

    Raises:
        SceneError: saying what to change.
    """
    require_roomy_eyeball(scene, f"c reaches {LARGEST_C_MM:g} mm")


def fill_space(
    scene: Scene, *, count: int, seed: int, csv_file: Path, before: Iterable[ModelError] = ()
) -> Space:
    """Errors of all models over the space of geometries; writes model_error.csv as it goes.

    Args:
        scene: gives the scale, the spot's size at contact and the medium.
        count: of geometries, rounded up to a power of two or to whole blocks of such.
        seed: of the points.
        csv_file: file to write; it gets its name when it is complete.
        before: rows to write before those of the space.
    """
    cone = geometry_of(scene)
    filled = Space()
    with (
        written_whole(csv_file, replace=True) as partial,
        partial.open("w", encoding="utf-8") as file,
    ):
        file.write(",".join(ModelError._fields) + "\n")
        file.writelines(space.csv_line(row) for row in before)
        for block in space.blocks(
            count=count,
            seed=seed,
            scale=cone.scale,
            contact_radius=-cone.apex_offset * float(np.tan(cone.half_angle)),
        ):
            filled.add(block)
            file.write(space.csv_text(block, medium=scene.source.medium))
    return filled


def _trials(scene: Scene, *, quick: bool) -> list[rendered.EccentricTrial]:
    return rendered.trials(
        scene,
        pinhole_heights=pinhole_heights(scene),
        eccentricities=np.linspace(0.0, LARGEST_C_MM, 3 if quick else 9).tolist(),
        few=(4.0, LARGEST_C_MM) if quick else np.linspace(0.0, LARGEST_C_MM, 5).tolist(),
        frames=3 if quick else 12,
    )


def _withdrawals(scene: Scene, *, quick: bool) -> dict[tuple[float, float], Withdrawals]:
    """On exact contours: four pinholes, square to the wall and at the scene's incidence."""
    eccentricities = np.linspace(0.0, LARGEST_C_MM, 17 if quick else 81)
    found = {}
    for height in (0.0, *pinhole_heights(scene), np.inf):
        for incidence_deg in dict.fromkeys((0.0, scene.spot.incidence_deg)):
            own = scenes.changed(
                scene, {"microscope.pinhole_height_mm": height, "spot.incidence_deg": incidence_deg}
            )
            found[height, incidence_deg] = limits.withdrawals(
                geometry_of(own), eccentricities=eccentricities, medium=scene.source.medium
            )
    return found
