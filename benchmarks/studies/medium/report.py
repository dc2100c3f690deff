"""The report of the study of media: sentences, tables and figures, all from this run's numbers."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import matplotlib
import numpy as np
from matplotlib.figure import Figure

import optics
from benchmarks.evaluation import ACCEPTABLE_ERROR_MM
from benchmarks.reporting import Data, Picture, Report, Row, Section, Table
from benchmarks.studies.medium.light import (
    AIR,
    AIR_CONE,
    CONE,
    FARTHEST_MM,
    LENS,
    LENS_CONE,
    NEAREST_MM,
    VITREOUS,
    Curve,
    MediumError,
    Regression,
)
from benchmarks.studies.medium.run import Findings
from benchmarks.studies.validate import (
    BLACK,
    BLUE,
    DISTANCE,
    GREEN,
    GREY,
    VERMILION,
    Conclusion,
    figures,
    number,
)

_COLOURS = {AIR_CONE: VERMILION, LENS_CONE: BLUE, LENS: GREEN}


def report(findings: Findings) -> Report:
    """The report of a run."""
    with matplotlib.rc_context(figures.STYLE):
        return Report(
            title="What is a calibration in air worth in vitreous?",
            lead="The cone fitted to a glue lens in air, used in vitreous; and what the lens model "
            "makes of the same spots without another fit. An ideal cone, which no medium bends, is "
            "the control.",
            found=list(_found(findings)),
            sections=[
                Section(
                    "Error against distance",
                    Picture(
                        "error",
                        _error_figure(findings),
                        "Error of the distance: lines from the lens's light on a square plane, "
                        "marks from rendered frames of an eyeball (incidence "
                        f"{findings.scene.spot.incidence_deg:g}°) with the cone fitted to rendered "
                        "frames of a plane in air; squares are in air, open circles flagged "
                        "ambiguous, grey bands hold more than one distance for a radius (the green "
                        "dots: the solution farthest from the truth), the black dots are the "
                        f"clinically acceptable {ACCEPTABLE_ERROR_MM:g} mm.",
                        data="medium_error.csv",
                    ),
                    _error_table(findings.rows),
                    _METHODS,
                ),
                Section(
                    "Why",
                    Picture(
                        "radius",
                        _radius_figure(findings),
                        "Half-maximum radius of each light in each medium, and the cone that a "
                        "regression makes of it (dashed).",
                        data="medium_cones.csv",
                    ),
                    _cone_table(findings),
                ),
            ],
            data=[
                Data("medium_error.csv", MediumError, findings.rows),
                Data("medium_cones.csv", Regression, [c.regression for c in _curves(findings)]),
            ],
        )


_METHODS = (
    f"“{AIR_CONE}”: d = kR + b with k and b from air. “{LENS_CONE}”: k and b computed for vitreous "
    f"from the lens's own numbers. “{LENS}”: the distance at which the lens has this spot in "
    "vitreous; on its own curve it is right by construction wherever one radius belongs to one "
    "distance, so its lines show ambiguity alone (the solution farthest from the truth), and only "
    "its rendered marks, where the profile's shape helps to decide, say how good it is. The lens's "
    "numbers are the scene's own: what a fit in air would leave of doubt in them is not in it."
)


def _found(findings: Findings) -> Iterable[Conclusion]:
    for name in _lenses(findings):
        in_air = _largest(findings.rows, "analytic", name, AIR, AIR_CONE)
        wrong = _largest(findings.rows, "analytic", name, VITREOUS, AIR_CONE)
        right = _largest(findings.rows, "analytic", name, VITREOUS, LENS_CONE)
        air, vitreous = (findings.curves[name, m].regression for m in (AIR, VITREOUS))
        yield Conclusion(
            f"air to vitreous, {name}",
            f"{name}: calibrated in air, the distance in vitreous is off by up to "
            f"{number(wrong, 2)} mm.",
            f"In air itself it is off by {number(in_air, 2)} mm at most, as a lens is no cone. In "
            f"vitreous k is {number(vitreous.k, 1)} instead of {number(air.k, 1)} and b "
            f"{number(vitreous.b_mm, 2)} instead of {number(air.b_mm, 2)} mm; the cone that the "
            f"lens model gives for vitreous is off by {number(right, 2)} mm at most.",
            wrong <= ACCEPTABLE_ERROR_MM,
        )
    for name in _lenses(findings):
        yield _rendered_found(findings, name)
    yield _control_found(findings)


def _rendered_found(findings: Findings, name: str) -> Conclusion:
    lens = _some(findings.rows, "rendered", name, VITREOUS, LENS)
    sure = [abs(r.error_mm) for r in lens if not r.ambiguous and math.isfinite(r.error_mm)]
    cone = np.abs(_errors(findings.rows, "rendered", name, VITREOUS, AIR_CONE))
    median = float(np.median(sure)) if sure else math.nan
    return Conclusion(
        f"lens model, {name}",
        f"{name}: in rendered vitreous the lens model is off by {number(median, 3)} mm, the cone "
        f"of air by {number(float(np.median(cone)), 2)} mm (medians).",
        f"{len(lens)} spots, {sum(row.ambiguous for row in lens)} of them flagged ambiguous, "
        f"{sum(not math.isfinite(row.error_mm) for row in lens)} without an answer. Of the "
        f"{len(sure)} others {sum(e > ACCEPTABLE_ERROR_MM for e in sure)} are off by more than "
        f"{ACCEPTABLE_ERROR_MM:g} mm, the worst by {number(max(sure, default=math.nan), 3)} mm.",
    )


def _control_found(findings: Findings) -> Conclusion:
    air, vitreous = (
        {r.d_mm: r.error_mm for r in _some(findings.rows, "rendered", CONE, m, AIR_CONE)}
        for m in (AIR, VITREOUS)
    )
    both = [abs(vitreous[d] - air[d]) for d in air.keys() & vitreous.keys()]
    largest = max(both, default=math.nan)
    return Conclusion(
        "control",
        f"The ideal cone's rendered distances differ by {number(largest, 4)} mm at most between "
        "the media.",
        f"{len(both)} pairs of frames of the same seed: no medium bends the cone, so only what the "
        "study itself does to its spots could tell them apart.",
    )


def _error_table(rows: Sequence[MediumError]) -> Table:
    cells: list[Row] = []
    keys = dict.fromkeys((row.source, row.light, row.medium, row.method) for row in rows)
    for key in keys:
        errors = _errors(rows, *key)
        finite = [e for e in errors if math.isfinite(e)]
        unclear = 100 * float(np.mean([row.ambiguous for row in _some(rows, *key)]))
        worst = max((abs(e) for e in finite), default=math.nan)
        mean = float(np.mean(finite)) if finite else math.nan
        cells.append((*key, len(errors), mean, _rms(finite), worst, unclear))
    return Table(
        (
            "source",
            "light",
            "medium",
            "method",
            "spots",
            "mean, mm",
            "rms, mm",
            "largest, mm",
            "ambiguous, %",
        ),
        cells,
        f"Errors over d = {NEAREST_MM:g} to {FARTHEST_MM:g} mm.",
        data="medium_error.csv",
    )


def _cone_table(findings: Findings) -> Table:
    cells: list[Row] = []
    for curve in _curves(findings):
        cone = curve.regression
        unclear = (
            f"{cone.ambiguous_from_mm:.2f} to {cone.ambiguous_to_mm:.2f}"
            if math.isfinite(cone.ambiguous_from_mm)
            else "none"
        )
        index = float(optics.MEDIA[curve.medium])
        cells.append((cone.light, cone.medium, index, cone.k, cone.b_mm, cone.r_squared, unclear))
    return Table(
        ("light", "medium", "index", "k", "b, mm", "R²", "ambiguous at d, mm"),
        cells,
        f"Cones d = kR + b of the half-maximum radius over d = {NEAREST_MM:g} to "
        f"{FARTHEST_MM:g} mm.",
        data="medium_cones.csv",
    )


def _error_figure(findings: Findings) -> Figure:
    names = [*_lenses(findings), CONE]
    page = Figure(figsize=(10.0, 3.9), layout="constrained")
    grid = page.subplots(1, len(names), squeeze=False)[0]
    for axes, name in zip(grid, names, strict=True):
        axes.axhline(0, color=GREY, lw=0.8)
        for limit in (-ACCEPTABLE_ERROR_MM, ACCEPTABLE_ERROR_MM):
            axes.axhline(limit, color=BLACK, lw=0.8, ls=":")
        cone = findings.curves[name, VITREOUS].regression
        if math.isfinite(cone.ambiguous_from_mm):
            axes.axvspan(cone.ambiguous_from_mm, cone.ambiguous_to_mm, color="#EEEEEE", zorder=0)
        for method, colour in _COLOURS.items():
            for medium, style in ((AIR, "--"), (VITREOUS, "-")):
                if medium == AIR and method != AIR_CONE:
                    continue
                line = _some(findings.rows, "analytic", name, medium, method)
                marks = _some(findings.rows, "rendered", name, medium, method)
                clear = [row._replace(error_mm=math.nan) if row.ambiguous else row for row in line]
                axes.plot(*_points(clear), ls=style, color=colour, label=f"{method}, in {medium}")
                if any(row.ambiguous for row in line):
                    axes.plot(*_points(line), ls=":", lw=0.9, color=colour)
                for unclear in (False, True):
                    chosen = [row for row in marks if row.ambiguous == unclear]
                    face = "none" if unclear or medium == AIR else colour
                    shape = "s" if medium == AIR else "o"
                    axes.plot(*_points(chosen), ls="", marker=shape, ms=4, color=colour, mfc=face)
        axes.set_title(name)
        axes.set_xlabel(DISTANCE)
    grid[0].set_ylabel("estimate − truth (mm)")
    page.legend(*grid[0].get_legend_handles_labels(), loc="outside lower center", ncols=4)
    return page


def _radius_figure(findings: Findings) -> Figure:
    page = Figure(figsize=(10.0, 3.6), layout="constrained")
    names = [*_lenses(findings), CONE]
    grid = page.subplots(1, len(names), squeeze=False, sharey=True)[0]
    for axes, name in zip(grid, names, strict=True):
        for medium, colour in ((AIR, VERMILION), (VITREOUS, BLUE)):
            curve = findings.curves[name, medium]
            asked = (curve.distance >= NEAREST_MM) & (curve.distance <= FARTHEST_MM)
            d, radius = curve.distance[asked], curve.radius[asked]
            axes.plot(d, radius, color=colour, label=medium)
            cone = curve.regression
            axes.plot(d, (d - cone.b_mm) / cone.k, color=colour, lw=0.9, ls="--")
        axes.set_title(name)
        axes.set_xlabel(DISTANCE)
    grid[0].set_ylabel("half-maximum radius (mm)")
    grid[0].legend(loc="upper left")
    return page


def _points(rows: Sequence[MediumError]) -> tuple[list[float], list[float]]:
    return [row.d_mm for row in rows], [row.error_mm for row in rows]


def _lenses(findings: Findings) -> list[str]:
    return list(dict.fromkeys(name for name, _ in findings.curves if name != CONE))


def _curves(findings: Findings) -> Iterable[Curve]:
    return findings.curves.values()


def _some(
    rows: Sequence[MediumError], source: str, light: str, medium: str, method: str
) -> list[MediumError]:
    key = (source, light, medium, method)
    return [r for r in rows if (r.source, r.light, r.medium, r.method) == key]


def _errors(
    rows: Sequence[MediumError], source: str, light: str, medium: str, method: str
) -> list[float]:
    return [row.error_mm for row in _some(rows, source, light, medium, method)]


def _largest(
    rows: Sequence[MediumError], source: str, light: str, medium: str, method: str
) -> float:
    errors = [e for e in _errors(rows, source, light, medium, method) if math.isfinite(e)]
    return max(map(abs, errors), default=math.nan)


def _rms(errors: Sequence[float]) -> float:
    return float(np.sqrt(np.mean(np.square(errors)))) if len(errors) else math.nan
