"""Figures of the study of media."""

from __future__ import annotations

import math
from collections.abc import Sequence

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from benchmarks.evaluation import ACCEPTABLE_ERROR_MM, DISTANCE
from benchmarks.reporting import BLUE, GREEN, VERMILION, limit_lines, small_multiples
from benchmarks.studies.medium.findings import (
    AIR,
    FARTHEST_MM,
    NEAREST_MM,
    VITREOUS,
    MediumError,
    MediumFindings,
    Method,
)

_COLOURS = {Method.AIR_CONE: VERMILION, Method.LENS_CONE: BLUE, Method.LENS: GREEN}


def error_figure(findings: MediumFindings) -> Figure:
    """Error of each method against distance: a panel for each light."""

    def draw(axes: Axes, _: str, light: str) -> None:
        limit_lines(axes, ACCEPTABLE_ERROR_MM)
        cone = findings.curves[light, VITREOUS].regression
        if math.isfinite(cone.ambiguous_from_mm):
            axes.axvspan(cone.ambiguous_from_mm, cone.ambiguous_to_mm, color="#EEEEEE", zorder=0)
        shown = [(method, VITREOUS, "-", "o") for method in Method]
        for method, medium, style, shape in [(Method.AIR_CONE, AIR, "--", "s"), *shown]:
            colour = _COLOURS[method]
            line = findings.some("analytic", light, medium, method)
            marks = findings.some("rendered", light, medium, method)
            clear = [row._replace(error_mm=math.nan) if row.ambiguous else row for row in line]
            axes.plot(*_points(clear), ls=style, color=colour, label=f"{method}, in {medium}")
            if any(row.ambiguous for row in line):
                axes.plot(*_points(line), ls=":", lw=0.9, color=colour)
            for unclear in (False, True):
                chosen = [row for row in marks if row.ambiguous == unclear]
                face = "none" if unclear or medium == AIR else colour
                axes.plot(*_points(chosen), ls="", marker=shape, ms=4, color=colour, mfc=face)

    y = "estimate − truth (mm)"
    return small_multiples(draw, rows=[""], columns=findings.lights, x=DISTANCE, y=y, height=3.4)


def radius_figure(findings: MediumFindings) -> Figure:
    """Half-maximum radius against distance: a panel for each light."""

    def draw(axes: Axes, _: str, light: str) -> None:
        for medium, colour in ((AIR, VERMILION), (VITREOUS, BLUE)):
            curve = findings.curves[light, medium]
            inside = (curve.distance >= NEAREST_MM) & (curve.distance <= FARTHEST_MM)
            d, radius = curve.distance[inside], curve.radius[inside]
            axes.plot(d, radius, color=colour, label=medium)
            cone = curve.regression
            axes.plot(d, (d - cone.b_mm) / cone.k, color=colour, lw=0.9, ls="--")

    y = "half-maximum radius (mm)"
    return small_multiples(
        draw, rows=[""], columns=findings.lights, x=DISTANCE, y=y, height=3.4, sharey=True
    )


def _points(rows: Sequence[MediumError]) -> tuple[list[float], list[float]]:
    return [row.d_mm for row in rows], [row.error_mm for row in rows]
