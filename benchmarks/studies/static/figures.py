"""Figures of the static study."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from benchmarks.evaluation import (
    ALL_PLANES,
    LITERAL,
    MEASURED,
    PAPERS_PLANES,
    READING,
    SUBPIXEL,
    TABLE_I,
    TRIAL_COLOURS,
)
from benchmarks.reporting import BLUE, GREY, small_multiples
from benchmarks.studies.static.findings import ALL, NONE, CausePart, Scope, StaticFindings


def trials(findings: StaticFindings) -> Figure:
    """d_r against e1' of all runs: planes and spheres (rows), by way of measuring (columns)."""
    highest = max(np.nanmax(m.readings) for _, m in findings.with_all.values())

    def draw(axes: Axes, wall: str, way: str) -> None:
        names, measured = findings.with_all[wall, way]
        for n, (name, colour) in enumerate(zip(names, TRIAL_COLOURS, strict=True)):
            spots = measured.semi_minor[:, n].ravel(), measured.readings[:, n].ravel()
            axes.plot(*spots, ".", ms=2.5, alpha=0.5, color=colour, label=name)
        if wall == "plane":
            d = np.array([0.0, highest])
            for line, colour in zip(PAPERS_PLANES.values(), TRIAL_COLOURS, strict=True):
                axes.plot((d - line.b) / line.delta_k, d, color=colour, lw=0.8)
        axes.legend(loc="lower right", markerscale=3)

    return small_multiples(
        draw,
        rows=["plane", "sphere"],
        columns=[LITERAL.name, SUBPIXEL.name],
        x=MEASURED,
        y=READING,
        height=3.2,
        legend_columns=0,
        sharex=True,
        sharey=True,
    )


def causes(parts: list[CausePart]) -> Figure:
    """Parts of the mean square error, of each trial's line and of all trials' line."""

    def draw(axes: Axes, _: str, scope: Scope) -> None:
        rows = [part for part in parts if part.scope == scope][::-1]
        axes.barh(
            [part.cause for part in rows],
            [1e3 * part.part_mm2 for part in rows],
            xerr=np.nan_to_num([1e3 * part.standard_error_mm2 for part in rows]),
            color=[GREY if part.cause in (NONE, ALL) else BLUE for part in rows],
            height=0.6,
        )
        printed = [TABLE_I[ALL_PLANES]] if scope == Scope.POOLED else PAPERS_PLANES.values()
        for line in printed:
            axes.axvline(1e3 * line.rmse**2, color=GREY, lw=0.8, ls=":")

    x = "mean square error of the line (10$^{-3}$ mm²)"
    return small_multiples(
        draw, rows=[""], columns=list(Scope), x=x, y="", height=3.2, legend_columns=0
    )
