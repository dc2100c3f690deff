"""`eyespot study medium`: calibrated in air, used in vitreous.

DIR/medium_error.csv  every estimate, analytic and rendered, with its error
    medium_cones.csv  the cone that each lens makes in each medium
    stacks/, spots/   rendered frames, and the spots measured in them
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

import optics
import scenes
from benchmarks.evaluation import ACCEPTABLE_ERROR_MM, DISTANCE, largest, mean, rms
from benchmarks.reporting import (
    BLUE,
    GREEN,
    VERMILION,
    Claim,
    Column,
    Picture,
    Report,
    Request,
    Section,
    Study,
    Table,
    limit_lines,
    small_multiples,
)
from benchmarks.studies.medium import light, rendered
from benchmarks.studies.medium.light import (
    AIR,
    CONE,
    FARTHEST_MM,
    NEAREST_MM,
    VITREOUS,
    Curve,
    Method,
)
from scenes import Scene, SceneError
from scenes.world import World

_LENSES = ("paper-candidate", "dome")
"""A flat end and a round cap: the two kinds of drop."""


def run(request: Request) -> pd.DataFrame:
    """Compute, render, compare and report.

    Returns:
        The rows of medium_error.csv.

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
    errors = [
        light.analytic_errors(curves[name, AIR], curve, distances=distances)
        for (name, _), curve in curves.items()
    ]
    with study.timed("render and measure"):
        errors.append(rendered.measure(study, frames=6 if quick else 23, curves=curves))
    table = pd.concat(errors, ignore_index=True)
    study.publish(lambda errors: _report(scene, curves, errors), table)
    return table


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


# Figures.

_COLOURS = {Method.AIR_CONE: VERMILION, Method.LENS_CONE: BLUE, Method.LENS: GREEN}


def _error_figure(curves: Mapping[tuple[str, str], Curve], errors: pd.DataFrame) -> Figure:
    """Error of each method against distance: a panel for each light."""

    def draw(axes: Axes, _: str, light: str) -> None:
        limit_lines(axes, ACCEPTABLE_ERROR_MM)
        cone = curves[light, VITREOUS].cone
        if math.isfinite(cone.ambiguous_from_mm):
            axes.axvspan(cone.ambiguous_from_mm, cone.ambiguous_to_mm, color="#EEEEEE", zorder=0)
        shown = [(method, VITREOUS, "-", "o") for method in Method]
        for method, medium, style, shape in [(Method.AIR_CONE, AIR, "--", "s"), *shown]:
            colour = _COLOURS[method]
            line = _some(errors, "analytic", light, medium, method)
            marks = _some(errors, "rendered", light, medium, method)
            clear = line.error_mm.mask(line.ambiguous)
            axes.plot(line.d_mm, clear, ls=style, color=colour, label=f"{method}, in {medium}")
            if line.ambiguous.any():
                axes.plot(line.d_mm, line.error_mm, ls=":", lw=0.9, color=colour)
            for unclear, chosen in marks.groupby("ambiguous"):
                face = "none" if unclear or medium == AIR else colour
                points = chosen.d_mm, chosen.error_mm
                axes.plot(*points, ls="", marker=shape, ms=4, color=colour, mfc=face)

    y = "estimate − truth (mm)"
    return small_multiples(draw, rows=[""], columns=_lights(curves), x=DISTANCE, y=y, height=3.4)


def _radius_figure(curves: Mapping[tuple[str, str], Curve]) -> Figure:
    """Half-maximum radius against distance: a panel for each light."""

    def draw(axes: Axes, _: str, light: str) -> None:
        for medium, colour in ((AIR, VERMILION), (VITREOUS, BLUE)):
            curve = curves[light, medium]
            inside = (curve.distance >= NEAREST_MM) & (curve.distance <= FARTHEST_MM)
            d, radius = curve.distance[inside], curve.radius[inside]
            axes.plot(d, radius, color=colour, label=medium)
            cone = curve.cone
            axes.plot(d, (d - cone.b_mm) / cone.k, color=colour, lw=0.9, ls="--")

    y = "half-maximum radius (mm)"
    return small_multiples(
        draw, rows=[""], columns=_lights(curves), x=DISTANCE, y=y, height=3.4, sharey=True
    )


def _lights(curves: Mapping[tuple[str, str], Curve]) -> list[str]:
    """The lenses and the cone, in order."""
    return list(dict.fromkeys(light for light, _ in curves))


def _some(
    errors: pd.DataFrame, source: str, light: str, medium: str, method: Method
) -> pd.DataFrame:
    return errors[
        (errors.source == source)
        & (errors.light == light)
        & (errors.medium == medium)
        & (errors.method == method)
    ]


# The page.


def _report(scene: Scene, curves: Mapping[tuple[str, str], Curve], errors: pd.DataFrame) -> Report:
    cones = pd.DataFrame([curve.cone for curve in curves.values()])
    by_method = errors.groupby(["source", "light", "medium", "method"], sort=False)
    summary = by_method.error_mm.agg(spots="size", mean_mm=mean, rms_mm=rms, largest_mm=largest)
    summary = summary.join(by_method.ambiguous.mean()).reset_index()
    indices = ", ".join(f"{medium} {float(optics.MEDIA[medium]):g}" for medium in (AIR, VITREOUS))
    return Report(
        title="How large is the error of a calibration in air when it is used in vitreous?",
        lead="The cone fitted to a glue lens in air is used in vitreous, and compared with the "
        "lens model for the same spots, which needs no other fit. The control is an ideal cone, "
        "whose light no medium refracts.",
        claims=list(_claims(curves, errors)),
        sections=[
            Section(
                "Error against distance",
                Picture(
                    "error",
                    _error_figure(curves, errors),
                    "Error of the distance. Lines: computed from the lens's light on a square "
                    "plane. Marks: rendered frames of an eyeball (incidence "
                    f"{scene.spot.incidence_deg:g}°), with the cone fitted to rendered "
                    "frames of a plane in air. Squares are in air; open circles are flagged "
                    "ambiguous. In the grey bands one radius belongs to several distances; the "
                    "dotted green line is the solution farthest from the truth. Dashed: the "
                    f"clinically acceptable {ACCEPTABLE_ERROR_MM:g} mm.",
                    data="medium_error.csv",
                ),
                Table.of(
                    summary,
                    {
                        "source": Column("source"),
                        "light": Column("light"),
                        "medium": Column("medium"),
                        "method": Column("method"),
                        "spots": Column("spots"),
                        "mean_mm": Column("mean, mm"),
                        "rms_mm": Column("rms, mm"),
                        "largest_mm": Column("largest, mm"),
                        "ambiguous": Column("ambiguous, %", scale=100),
                    },
                    f"Errors over d = {NEAREST_MM:g} to {FARTHEST_MM:g} mm.",
                    data="medium_error.csv",
                ),
                _METHODS,
            ),
            Section(
                "Why",
                Picture(
                    "radius",
                    _radius_figure(curves),
                    "Half-maximum radius of each light in each medium, and the cone that a "
                    "regression makes of it (dashed).",
                    data="medium_cones.csv",
                ),
                Table.of(
                    cones,
                    {
                        "light": Column("light"),
                        "medium": Column("medium"),
                        "k": Column("k"),
                        "b_mm": Column("b, mm"),
                        "r_squared": Column("R²"),
                        "ambiguous_from_mm": Column("ambiguous from d, mm", 2),
                        "ambiguous_to_mm": Column("to d, mm", 2),
                    },
                    f"Cones d = kR + b of the half-maximum radius over d = {NEAREST_MM:g} to "
                    f"{FARTHEST_MM:g} mm, and the distances between which one radius belongs to "
                    f"several. Refractive indices: {indices}.",
                    data="medium_cones.csv",
                ),
            ),
        ],
        data={"medium_error.csv": errors, "medium_cones.csv": cones},
    )


_METHODS = (
    f"“{Method.AIR_CONE}”: d = kR + b with k and b from air. “{Method.LENS_CONE}”: k and b "
    f"computed for vitreous from the lens's parameters. “{Method.LENS}”: the distance at which the "
    "lens makes this spot in vitreous. On its own curve the lens model has no error by "
    "construction if only one distance has this radius, so its lines show only the ambiguity. Its "
    "rendered marks show its accuracy, because there the shape of the profile also contributes. "
    "The lens's parameters are those of the scene, without the uncertainty of a fit in air."
)


def _claims(curves: Mapping[tuple[str, str], Curve], errors: pd.DataFrame) -> Iterator[Claim]:
    lenses = [light for light in _lights(curves) if light != CONE]
    for lens in lenses:
        air, vitreous = (curves[lens, medium].cone for medium in (AIR, VITREOUS))

        def worst(lens: str, medium: str, method: Method) -> float:
            return largest(_some(errors, "analytic", lens, medium, method).error_mm)

        yield Claim(
            name=f"air to vitreous, {lens}",
            sentence="Calibrated in air, the distance in vitreous is off by up to {value:.2f} mm "
            "(acceptable: {high:g} mm). In air it is off by up to {in_air:.2f} mm, because a lens "
            "is no cone. In vitreous k is {vitreous.k:.1f} instead of {air.k:.1f} and b is "
            "{vitreous.b_mm:.2f} instead of {air.b_mm:.2f} mm. The cone that the lens model "
            "computes for vitreous is off by up to {lens_cone:.2f} mm.",
            value=worst(lens, VITREOUS, Method.AIR_CONE),
            high=ACCEPTABLE_ERROR_MM,
            numbers={
                "in_air": worst(lens, AIR, Method.AIR_CONE),
                "air": air,
                "vitreous": vitreous,
                "lens_cone": worst(lens, VITREOUS, Method.LENS_CONE),
            },
        )
    for lens in lenses:
        rows = _some(errors, "rendered", lens, VITREOUS, Method.LENS)
        sure = rows.error_mm[~rows.ambiguous].dropna().abs()
        cone = _some(errors, "rendered", lens, VITREOUS, Method.AIR_CONE).error_mm.abs()
        yield Claim(
            name=f"lens model, {lens}",
            sentence="In rendered vitreous the lens model is off by {value:.3f} mm and the cone of "
            "air by {cone:.2f} mm (medians). Of {spots} spots {ambiguous} are flagged ambiguous "
            "and {unanswered} have no answer. Of the other {sure} spots {beyond} are off by more "
            "than {limit:g} mm, the worst by {worst:.3f} mm.",
            value=float(sure.median()),
            numbers={
                "cone": float(cone.median()),
                "spots": len(rows),
                "ambiguous": int(rows.ambiguous.sum()),
                "unanswered": int(rows.error_mm.isna().sum()),
                "sure": len(sure),
                "beyond": int((sure > ACCEPTABLE_ERROR_MM).sum()),
                "limit": ACCEPTABLE_ERROR_MM,
                "worst": largest(sure),
            },
        )
    in_air, in_vitreous = (
        _some(errors, "rendered", CONE, medium, Method.AIR_CONE).set_index("d_mm").error_mm
        for medium in (AIR, VITREOUS)
    )
    differences = (in_vitreous - in_air).dropna()
    yield Claim(
        name="control",
        sentence="The ideal cone's rendered distances differ by {value:.4f} mm at most between the "
        "media ({pairs} pairs of frames of the same seed). No medium refracts the cone, so any "
        "difference would be an error of the study itself.",
        value=largest(differences),
        numbers={"pairs": len(differences)},
    )
