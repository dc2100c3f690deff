"""Pictures of the study of eccentricity."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

import optics
from benchmarks.evaluation import ModelError
from benchmarks.studies.eccentricity.causes import CAUSES, Part
from benchmarks.studies.eccentricity.limits import LIMITS_MM, Refit, Withdrawals
from benchmarks.studies.eccentricity.space import AXES, PINHOLES, Spread
from benchmarks.studies.validate import (
    BLACK,
    BLUE,
    ECCENTRICITY,
    GREEN,
    GREY,
    MODEL_COLOURS,
    ORANGE,
    PURPLE,
    SKY,
    VERMILION,
    pinhole_title,
)

COLOURS = {"planar": ORANGE} | MODEL_COLOURS
CAUSE_COLOURS = dict(
    zip(
        CAUSES,
        (BLUE, VERMILION, ORANGE, BLACK, GREEN, SKY, PURPLE, "#B8B8B8", "#6E6E6E"),
        strict=True,
    )
)
AXIS_NAMES = {
    "c_mm": ECCENTRICITY,
    "d_mm": "distance $d$ (mm)",
    "r_mm": "eye radius $r$ (mm)",
    "incidence_deg": "incidence (°)",
    "azimuth_deg": "its azimuth (°)",
    "half_angle_deg": "half-angle (°)",
}
PINHOLE_NAMES = {
    "centre": "$z_F$ = 0",
    "sphere": "$z_F$ = $r$",
    "200": "$z_F$ = 200 mm",
    "inf": "telecentric",
}
_WIDTH_IN = 10.0
_LEAST_MM = 1e-3
"""Errors below it are drawn at the foot of a logarithmic axis."""


def largest_errors(
    withdrawals: dict[tuple[float, float], Withdrawals], rendered: Sequence[ModelError]
) -> Figure:
    """Largest error over d against c: a panel for each pinhole (row) and incidence (column)."""
    heights = list(dict.fromkeys(height for height, _ in withdrawals))
    incidences = list(dict.fromkeys(incidence for _, incidence in withdrawals))
    figure = Figure(figsize=(_WIDTH_IN, 2.4 * len(heights) + 0.4), layout="constrained")
    grid = figure.subplots(len(heights), len(incidences), sharex=True, sharey=True, squeeze=False)
    for row, height in zip(grid, heights, strict=True):
        for axes, incidence in zip(row, incidences, strict=True):
            for limit in LIMITS_MM:
                axes.axhline(limit, color=GREY, lw=0.8, ls=":")
            errors = withdrawals[height, incidence].errors
            there = [e for e in rendered if (e.z_f_mm, e.incidence_deg) == (height, incidence)]
            for model in optics.MODELS:
                line = _worst([e for e in errors if e.model == model and not e.refit])
                if model != "exact":  # right to rounding on its own contours
                    axes.plot(*line, color=COLOURS[model], label=model)
                marks = _worst([e for e in there if e.model == model and not e.refit])
                label = model if model == "exact" else None
                axes.plot(*marks, ls="", marker="o", ms=3.5, color=COLOURS[model], label=label)
            refit = _worst([e for e in errors if e.refit])
            axes.plot(*refit, color=COLOURS["small_plane"], ls="--", label="small_plane, c fitted")
            axes.set_title(f"{pinhole_title(height)}, incidence {incidence:g}°")
        row[0].set_ylabel("largest |error| (mm)")
    grid[0, 0].set(yscale="log", ylim=(_LEAST_MM, 12.0))
    grid[0, 0].yaxis.set_major_formatter("{x:g}")
    for axes in grid[-1]:
        axes.set_xlabel(ECCENTRICITY)
    handles = {
        label: handle
        for axes in grid.flat
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True)
    }
    figure.legend(handles.values(), handles.keys(), loc="outside lower center", ncols=6)
    return figure


def fitted_eccentricity(refits: Sequence[Refit]) -> Figure:
    """The c that a fit finds against the true one, and the largest error before and after."""
    shown = sorted({refit.incidence_deg for refit in refits})[-1]
    heights = list(dict.fromkeys(refit.z_f_mm for refit in refits))
    figure = Figure(figsize=(_WIDTH_IN, 3.4), layout="constrained")
    left, right = figure.subplots(1, 2)
    for height, colour in zip(heights, (GREEN, BLUE, VERMILION, BLACK), strict=False):
        rows = [r for r in refits if (r.z_f_mm, r.incidence_deg) == (height, shown)]
        c = [r.c_mm for r in rows]
        fitted = [r.fitted_c_mm for r in rows]
        left.plot(c, fitted, color=colour, label=pinhole_title(height))
        right.plot(c, [r.largest_error_mm for r in rows], color=colour)
        right.plot(c, [r.largest_residual_mm for r in rows], color=colour, ls="--")
    left.plot([0, max(c)], [0, max(c)], color=GREY, lw=0.8)
    left.set(xlabel="true " + ECCENTRICITY, ylabel="fitted $c$ (mm)")
    right.set(xlabel="true " + ECCENTRICITY, ylabel="largest |error| (mm)", yscale="log")
    right.set_ylim(bottom=_LEAST_MM)
    right.yaxis.set_major_formatter("{x:g}")
    left.legend(loc="upper left")
    return figure


def causes(parts: Sequence[Part], *, d: float) -> Figure:
    """Shapley's parts stacked against c: a row for each pinhole, a column for each model.

    Every panel has a scale of its own: the parts of the best model are a hundredth of the worst's.
    """
    heights = list(dict.fromkeys(part.z_f_mm for part in parts))
    chosen = [part for part in parts if abs(part.d_mm - d) < 1e-6]
    figure = Figure(figsize=(_WIDTH_IN, 2.7 * len(heights) + 0.6), layout="constrained")
    grid = figure.subplots(len(heights), len(optics.MODELS), sharex=True, squeeze=False)
    for row, height in zip(grid, heights, strict=True):
        for axes, model in zip(row, optics.MODELS, strict=True):
            here = [p for p in chosen if (p.z_f_mm, p.model) == (height, model)]
            c = np.array(sorted({round(p.c_mm, 6) for p in here}))
            width = 0.7 * (np.diff(c).min() if c.size > 1 else 1.0)
            above, below = np.zeros(c.size), np.zeros(c.size)
            for cause in CAUSES:
                size = np.array([p.part_mm for p in here if p.cause == cause])
                foot = np.where(size >= 0, above, below)
                axes.bar(c, size, width, bottom=foot, color=CAUSE_COLOURS[cause], label=cause)
                above += np.maximum(size, 0.0)
                below += np.minimum(size, 0.0)
            whole = [p.whole_mm for p in here if p.cause == CAUSES[0]]
            axes.plot(c, whole, ls="", marker="D", ms=4, mfc="white", mec=BLACK, label="whole")
            axes.axhline(0, color=BLACK, lw=0.6)
            axes.set_title(f"{model}, {pinhole_title(height)}")
        row[0].set_ylabel("part of the error (mm)")
    for axes in grid[-1]:
        axes.set_xlabel(ECCENTRICITY)
    figure.legend(*grid[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=5)
    return figure


def spreads(rows: Sequence[Spread]) -> Figure:
    """Size of the errors along every axis, over all others: a row for each pinhole."""
    figure = Figure(figsize=(_WIDTH_IN, 2.1 * len(PINHOLES) + 0.5), layout="constrained")
    grid = figure.subplots(len(PINHOLES), len(AXES), sharex="col", sharey=True)
    for line, pinhole in zip(grid, PINHOLES, strict=True):
        for axes, axis in zip(line, AXES, strict=True):
            for model in (m for m in optics.MODELS if m != "exact"):
                here = [r for r in rows if (r.model, r.pinhole, r.axis) == (model, pinhole, axis)]
                middle = [0.5 * (r.from_value + r.to_value) for r in here]
                axes.plot(middle, [r.median_mm for r in here], color=COLOURS[model], label=model)
                high = [r.percentile_95_mm for r in here]
                axes.plot(middle, high, color=COLOURS[model], lw=0.8, ls=":")
        line[0].set_ylabel(f"{PINHOLE_NAMES[pinhole]}\n|error| (mm)")
    grid[0, 0].set(yscale="log", ylim=(_LEAST_MM, 12.0))
    grid[0, 0].yaxis.set_major_formatter("{x:g}")
    for axes, axis in zip(grid[-1], AXES, strict=True):
        axes.set_xlabel(AXIS_NAMES[axis])
    figure.legend(*grid[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=4)
    return figure


def _worst(errors: Sequence[ModelError]) -> tuple[list[float], list[float]]:
    """Largest absolute error at each c."""
    worst: dict[float, float] = {}
    for e in errors:
        c = round(e.c_mm, 6)
        worst[c] = max(worst.get(c, 0.0), abs(e.error_mm))
    return sorted(worst), [worst[c] for c in sorted(worst)]
