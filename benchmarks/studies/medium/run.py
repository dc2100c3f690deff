"""`eyespot study medium`: calibrated in air, used in vitreous.

DIR/medium_error.csv  every estimate, analytic and rendered, with its error
    medium_cones.csv  the cone that each lens makes in each medium
    stacks/, spots/   what was rendered, and measured in it
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

import scenes
from benchmarks.reporting import Request, Study
from benchmarks.studies.medium import light, rendered
from benchmarks.studies.medium.light import AIR, VITREOUS, Curve, MediumError
from calibration import PlaneFit
from scenes import Scene, SceneError
from scenes.world import World

_LENSES = ("paper-candidate", "dome")
"""A flat end and a round cap: the two kinds of drop."""


@dataclass(frozen=True, kw_only=True)
class Findings:
    """What the report is made of.

    Attributes:
        scene: the study's.
        curves: by (light, medium): half-maximum radius against distance.
        fits: in air, on rendered planes, by light.
        rows: errors, analytic and rendered.
    """

    scene: Scene
    curves: dict[tuple[str, str], Curve]
    fits: dict[str, PlaneFit]
    rows: list[MediumError]


def run(request: Request) -> Findings:
    """Compute, render, compare and report.

    Args:
        request: what was asked for.

    Raises:
        SceneError: the scene's source is none of a lens.
        ValueError: the folder holds something else.
        RendererUnavailable: Mitsuba cannot run here.
    """
    from benchmarks.studies.medium import report as medium_report  # figures, needed at the end only

    study = Study("medium", request, check=check)
    scene, quick = study.scene, request.quick
    own = scene.source.lens
    lenses = (own,) if quick else tuple(dict.fromkeys((own, *_LENSES)))
    with study.timed("light of the lenses"):
        curves = {(n, m): light.lens_curve(n, m) for n in lenses for m in (AIR, VITREOUS)}
    ideal = scenes.changed(scene, {"source.kind": light.CONE})
    for medium in (AIR, VITREOUS):
        curves[light.CONE, medium] = light.cone_curve(World(ideal).cone, medium)
    distances = np.linspace(light.NEAREST_MM, light.FARTHEST_MM, 23 if quick else 111)
    rows = [
        row
        for (name, _), curve in curves.items()
        for row in light.analytic_errors(curves[name, AIR], curve, distances=distances)
    ]
    with study.timed("render and measure"):
        fits, seen = rendered.measure(study, frames=6 if quick else 23, curves=curves)
    findings = Findings(scene=scene, curves=curves, fits=fits, rows=rows + seen)
    study.publish(medium_report.report(findings))
    return findings


def check(scene: Scene) -> None:
    """Refuse a scene without a lens: the ideal cone knows no medium, and is the control anyway.

    Raises:
        SceneError: saying what to change.
    """
    if scene.source.kind != "lens":
        raise SceneError(
            "the study compares one lens in two media, and the ideal cone beside it; got "
            f"source.kind '{scene.source.kind}'. Set source.kind=lens."
        )
