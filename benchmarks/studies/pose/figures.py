"""Figures of the study of poses: errors beside their bounds and the best reported ones."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from benchmarks.evaluation import ECCENTRICITY, mean, rms
from benchmarks.reporting import BLUE, VERMILION, limit_lines, small_multiples
from benchmarks.studies.pose.findings import (
    INCIDENCE_DEG,
    NAMES,
    REPORTED,
    REQUIRED_DISTANCE_MM,
    PoseFindings,
    Prior,
)

_COLOURS = {1: BLUE, 3: VERMILION}
_MARKS: dict[str, dict[str, Any]] = {
    "analytic": {"marker": ".", "ms": 4, "alpha": 0.45},
    "rendered": {"marker": "x", "ms": 6},
}
_ASIDE = 0.1
"""Spots of one eccentricity are drawn side by side, in the order of their distances."""

_QUANTITIES = {"error of the tip (mm)": "tip_{}_mm", "error of the axis (°)": "axis_{}_deg"}


def by_incidence(findings: PoseFindings) -> Figure:
    """Errors of tip and axis against the incidence, for the first row's pinhole."""
    height = findings.rows[0].z_f_mm
    edges = np.linspace(*INCIDENCE_DEG, 6)

    def draw(axes: Axes, _: str, quantity: str) -> None:
        error, bound = (_QUANTITIES[quantity].format(name) for name in ("error", "bound"))
        for spots, colour in _COLOURS.items():
            for source, marks in _MARKS.items():
                rows = findings.some(source, spots, Prior.ROUGH)
                shown = [r for r in rows if not r.mirrored and r.z_f_mm == height]
                x = [row.incidence_deg for row in shown]
                y = [getattr(row, error) for row in shown]
                axes.plot(x, y, ls="", color=colour, label=f"{NAMES[spots]}, {source}", **marks)
            rows = findings.some("analytic", spots, Prior.ROUGH)
            bounds = [
                rms(getattr(row, bound) for row in rows if low <= row.incidence_deg < high)
                for low, high in itertools.pairwise(edges)
            ]
            axes.plot(0.5 * (edges[:-1] + edges[1:]), bounds, color=colour, lw=1.6)
            reported = dict(zip(_QUANTITIES, REPORTED[spots], strict=True))[quantity]
            axes.axhline(reported, color=colour, ls=":", lw=1.0)
        axes.set(yscale="log")

    columns = list(_QUANTITIES)
    return small_multiples(draw, rows=[""], columns=columns, x="incidence (°)", y="", height=3.7)


def known_axis(findings: PoseFindings) -> Figure:
    """Errors of the distance in rendered frames with a known axis, against c."""
    rows = findings.some("rendered", 1, Prior.KNOWN)
    middle = mean(row.d_mm for row in rows)

    def draw(axes: Axes, *_: str) -> None:
        limit_lines(axes, 1e3 * REQUIRED_DISTANCE_MM)
        axes.errorbar(
            [row.c_mm + _ASIDE * (row.d_mm - middle) for row in rows],
            [1e3 * row.distance_error_mm for row in rows],
            yerr=[1e3 * row.sigma_distance_mm for row in rows],
            fmt="x",
            capsize=2,
            color=BLUE,
        )

    y = "error of $d$ (µm)"
    return small_multiples(
        draw, rows=[""], columns=[""], x=ECCENTRICITY, y=y, height=3.2, legend_columns=0
    )
