"""Figures of the study of eccentricity."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

import optics
from benchmarks.evaluation import ECCENTRICITY, MODEL_COLOURS, largest_errors, pinhole_title
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
from benchmarks.studies.eccentricity.causes import CAUSES
from benchmarks.studies.eccentricity.findings import (
    AXES,
    LIMITS_MM,
    PINHOLES,
    EccentricityFindings,
    Refit,
)

_COLOURS = {"planar": ORANGE} | MODEL_COLOURS
_BROWN, _GREYS = "#8C6D31", ("#B8B8B8", "#6E6E6E")
_CAUSE_COLOURS = dict(
    zip(CAUSES, (BLUE, VERMILION, ORANGE, BLACK, GREEN, SKY, PURPLE, _BROWN, *_GREYS), strict=True)
)
_AXIS_NAMES = {
    "c_mm": ECCENTRICITY,
    "d_mm": "distance $d$ (mm)",
    "r_mm": "eye radius $r$ (mm)",
    "incidence_deg": "incidence (°)",
    "azimuth_deg": "its azimuth (°)",
    "half_angle_deg": "half-angle (°)",
}
_PINHOLE_NAMES = {
    "centre": "$z_F$ = 0",
    "sphere": "$z_F$ = $r$",
    "200": "$z_F$ = 200 mm",
    "inf": "telecentric",
}
_LEAST_MM = 1e-3
"""Smaller errors are drawn at the foot of a logarithmic axis."""


def worst_errors(findings: EccentricityFindings) -> Figure:
    """Largest error over d against c: a panel for each pinhole (row) and incidence (column)."""

    def draw(axes: Axes, height: float, incidence: float) -> None:
        for limit in LIMITS_MM:
            axes.axhline(limit, color=GREY, lw=0.8, ls=":")
        exact = findings.withdrawals[height, incidence].errors
        seen = [e for e in findings.rendered.with_true_c if e[7:9] == (height, incidence)]
        for model, colour in _COLOURS.items():
            line = largest_errors(e for e in exact if e.model == model and not e.refit)
            if model != "exact":  # right to rounding on its own contours
                axes.plot(*line, color=colour, label=model)
            marks = largest_errors(e for e in seen if e.model == model)
            label = model if model == "exact" else None
            axes.plot(*marks, ls="", marker="o", ms=3.5, color=colour, label=label)
        refit = largest_errors(e for e in exact if e.refit)
        label = "small_plane, c fitted"
        axes.plot(*refit, color=VERMILION, ls="--", label=label)
        _logarithmic(axes, top=12.0)

    return small_multiples(
        draw,
        rows=list(dict.fromkeys(height for height, _ in findings.withdrawals)),
        columns=list(dict.fromkeys(incidence for _, incidence in findings.withdrawals)),
        title=lambda height, incidence: f"{pinhole_title(height)}, incidence {incidence:g}°",
        x=ECCENTRICITY,
        y="largest |error| (mm)",
        height=2.4,
        legend_columns=6,
        sharex=True,
        sharey=True,
    )


def fitted_eccentricity(findings: EccentricityFindings) -> Figure:
    """The c that a fit finds against the true one, and the largest error before and after."""
    incidence = findings.scene.spot.incidence_deg
    by_height: dict[float, list[Refit]] = {}
    for refit in findings.refits:
        if refit.incidence_deg == incidence:
            by_height.setdefault(refit.z_f_mm, []).append(refit)
    drawn = list(zip(by_height.items(), (GREEN, BLUE, VERMILION, BLACK), strict=False))

    def fitted(axes: Axes) -> None:
        for (height, rows), colour in drawn:
            c = [r.c_mm for r in rows]
            label = pinhole_title(height)
            axes.plot(c, [r.fitted_c_mm for r in rows], color=colour, label=label)
            axes.plot(c, c, color=GREY, lw=0.8)

    def sizes(axes: Axes) -> None:
        for (_, rows), colour in drawn:
            c = [r.c_mm for r in rows]
            axes.plot(c, [r.largest_error_mm for r in rows], color=colour)
            axes.plot(c, [r.largest_residual_mm for r in rows], color=colour, ls="--")
        _logarithmic(axes)

    panels = {"fitted $c$ (mm)": fitted, "largest |error| (mm)": sizes}
    return small_multiples(
        lambda axes, _, name: panels[name](axes),
        rows=[""],
        columns=list(panels),
        x=f"true {ECCENTRICITY}",
        y="",
        height=3.4,
    )


def causes(findings: EccentricityFindings, *, d: float) -> Figure:
    """Shapley's shares stacked against c: a row for each pinhole, a column for each model.

    Every panel has its own scale: the shares of the best model are a hundredth of the worst's.
    """
    chosen = [share for share in findings.rendered.shares if abs(share.d_mm - d) < 1e-6]

    def draw(axes: Axes, height: float, model: str) -> None:
        here = [p for p in chosen if (p.z_f_mm, p.model) == (height, model)]
        c = np.array(sorted({round(p.c_mm, 6) for p in here}))
        width = 0.7 * (np.diff(c).min() if c.size > 1 else 1.0)
        above, below = np.zeros(c.size), np.zeros(c.size)
        for cause, colour in _CAUSE_COLOURS.items():
            size = np.array([p.part_mm for p in here if p.cause == cause])
            foot = np.where(size >= 0, above, below)
            axes.bar(c, size, width, bottom=foot, color=colour, label=cause)
            above += np.maximum(size, 0.0)
            below += np.minimum(size, 0.0)
        whole = [p.whole_mm for p in here if p.cause == CAUSES[0]]
        axes.plot(c, whole, ls="", marker="D", ms=4, mfc="white", mec=BLACK, label="whole")
        axes.axhline(0, color=BLACK, lw=0.6)

    return small_multiples(
        draw,
        rows=list(dict.fromkeys(share.z_f_mm for share in chosen)),
        columns=optics.MODELS,
        title=lambda height, model: f"{model}, {pinhole_title(height)}",
        x=ECCENTRICITY,
        y="part of the error (mm)",
        legend_columns=5,
        sharex=True,
    )


def spreads(findings: EccentricityFindings) -> Figure:
    """Size of the errors along every axis, over all others: a row for each pinhole."""

    def draw(axes: Axes, pinhole: str, axis: str) -> None:
        for model, colour in _COLOURS.items():
            rows = [r for r in findings.spreads if r[:3] == (model, pinhole, axis)]
            if model != "exact":
                middle = [0.5 * (r.from_value + r.to_value) for r in rows]
                axes.plot(middle, [r.median_mm for r in rows], color=colour, label=model)
                axes.plot(middle, [r.percentile_95_mm for r in rows], color=colour, lw=0.8, ls=":")
        _logarithmic(axes, top=12.0)

    return small_multiples(
        draw,
        rows=PINHOLES,
        columns=list(AXES),
        title=lambda pinhole, axis: "",
        x=_AXIS_NAMES.__getitem__,
        y=lambda pinhole: f"{_PINHOLE_NAMES[pinhole]}\n|error| (mm)",
        height=2.1,
        sharex="col",
        sharey=True,
    )


def _logarithmic(axes: Axes, *, top: float | None = None) -> None:
    axes.set(yscale="log")
    axes.set_ylim(_LEAST_MM, top)
    axes.yaxis.set_major_formatter("{x:g}")
