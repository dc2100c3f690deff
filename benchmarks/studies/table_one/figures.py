"""The figure of the study of Table I: which lenses fit, and spots of some against distance."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from benchmarks.evaluation import LITERAL, MEASURED, PAPERS_PLANES, READING, SUBPIXEL, Way
from benchmarks.reporting import (
    BLACK,
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    PURPLE,
    SKY,
    VERMILION,
    small_multiples,
)
from benchmarks.studies.table_one.findings import Demand, TableOneFindings
from benchmarks.studies.table_one.isophotes import FARTHEST_MM
from benchmarks.studies.table_one.moments import even_span
from benchmarks.studies.table_one.scan import readings

_COLOURS = (BLUE, VERMILION, GREEN, ORANGE, PURPLE, SKY, BLACK)


def figure(findings: TableOneFindings) -> Figure:
    """Misfit of each lens; spots of the rendered ones, thresholded and at half maximum."""
    panels: dict[str, Callable[[Axes], None]] = {
        "worst violation / tolerance": lambda axes: _misses(axes, findings),
        f"fixed threshold: {READING}": lambda axes: _spots(axes, findings, way=LITERAL),
        f"half maximum: {READING}": lambda axes: _spots(axes, findings, way=SUBPIXEL),
    }
    misses, *spots = panels
    labels = {misses: "sag of the cap (mm)"} | dict.fromkeys(spots, MEASURED)
    return small_multiples(
        lambda axes, _, name: panels[name](axes),
        rows=[""],
        columns=list(panels),
        x=labels.__getitem__,
        y="",
        height=4.0,
        legend_columns=0,
    )


def _misses(axes: Axes, findings: TableOneFindings) -> None:
    choices = findings.asked(Demand.AT_SCALE)
    for aperture, colour in zip(
        sorted({c.numerical_aperture for c in choices}), _COLOURS, strict=False
    ):
        own = sorted((c.sag_mm, c.miss) for c in choices if c.numerical_aperture == aperture)
        axes.plot(*np.transpose(own), marker="o", ms=3, color=colour, label=f"NA {aperture:.2f}")
    axes.axhline(1.0, color=GREY, lw=0.8, ls=":")
    axes.set(yscale="log")
    axes.yaxis.set_major_formatter("{x:g}")
    axes.legend(loc="lower right")


def _spots(axes: Axes, findings: TableOneFindings, *, way: Way) -> None:
    d_r = readings(0.0, FARTHEST_MM)
    for one, colour in zip(findings.confirmed, _COLOURS, strict=False):
        choice = one.choice
        isophotes = findings.isophotes[choice.family]
        if way is LITERAL:
            radius = isophotes.radius(d_r, level=np.full_like(d_r, choice.level))
        else:
            radius = isophotes.half_maximum(d_r)
        seen = (d_r <= choice.to_mm) & (radius > 0)
        label = f"NA {choice.numerical_aperture:.2f}, sag {choice.sag_mm:g} mm"
        axes.plot(radius[seen] / choice.scale_mm_px, d_r[seen], color=colour, label=label)
        for (measured, _), spots in one.spots.items():
            if measured == way.name:
                axes.plot(*spots, ".", ms=3, color=colour)
    for row in PAPERS_PLANES.values():
        d = np.array([0.0, even_span(row)])
        axes.plot((d - row.b) / row.delta_k, d, color=GREY, lw=2, alpha=0.5, zorder=0)
    axes.set_xlim(left=0)
    axes.legend(loc="lower right")
