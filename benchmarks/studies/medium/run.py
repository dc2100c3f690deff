"""`eyespot study medium`: calibrated in air, used in vitreous.

DIR/medium_error.csv  every estimate, analytic and rendered, with its error
    medium_cones.csv  the cone that each lens makes in each medium
    stacks/, spots/   rendered frames, and the spots measured in them
"""

from __future__ import annotations

import numpy as np

import scenes
from benchmarks.reporting import Request, Study
from benchmarks.studies.medium import light, rendered
from benchmarks.studies.medium.findings import (
    AIR,
    CONE,
    FARTHEST_MM,
    NEAREST_MM,
    VITREOUS,
    MediumFindings,
)
from benchmarks.studies.medium.report import report
from scenes import Scene, SceneError
from scenes.world import World

_LENSES = ("paper-candidate", "dome")
"""A flat end and a round cap: the two kinds of drop."""


def run(request: Request) -> MediumFindings:
    """Compute, render, compare and report.

    Args:
        request: the arguments.

    Raises:
        SceneError: the scene's source is not a lens.
        InputError: the folder has other files.
        RendererUnavailable: Mitsuba cannot run here.
    """
    study = Study("medium", request, check=check)
    scene, quick = study.scene, request.quick
    own = scene.source.lens
    lenses = (own,) if quick else tuple(dict.fromkeys((own, *_LENSES)))
    with study.timed("light of the lenses"):
        curves = {(n, m): light.lens_curve(n, m) for n in lenses for m in (AIR, VITREOUS)}
    ideal = scenes.changed(scene, {"source.kind": CONE})
    for medium in (AIR, VITREOUS):
        curves[CONE, medium] = light.cone_curve(World(ideal).cone, medium)
    distances = np.linspace(NEAREST_MM, FARTHEST_MM, 23 if quick else 111)
    rows = [
        row
        for (name, _), curve in curves.items()
        for row in light.analytic_errors(curves[name, AIR], curve, distances=distances)
    ]
    with study.timed("render and measure"):
        fits, seen = rendered.measure(study, frames=6 if quick else 23, curves=curves)
    findings = MediumFindings(scene=scene, curves=curves, fits=fits, rows=rows + seen)
    study.publish(report, findings)
    return findings


def check(scene: Scene) -> None:
    """Refuse a scene without a lens; the ideal cone, the control, does not change with the medium.

    Raises:
        SceneError: saying what to change.
    """
    if scene.source.kind != "lens":
        raise SceneError(
            "the study compares one lens in two media, and the ideal cone beside it; got "
            f"source.kind '{scene.source.kind}'. Set source.kind=lens."
        )
