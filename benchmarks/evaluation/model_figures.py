"""Labels and colours of the models, and their errors against eccentricity."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from benchmarks.evaluation.model_error import COMPARED
from benchmarks.evaluation.paper import ACCEPTABLE_ERROR_MM
from benchmarks.reporting import (
    BLACK,
    BLUE,
    GREEN,
    ORANGE,
    SKY,
    VERMILION,
    limit_lines,
    small_multiples,
)

CHOSEN_DISTANCES_MM = (0.5, 2.0, 4.0, 6.0)
"""Distances that tables and error curves show."""

MODEL_COLOURS = dict(zip(COMPARED, (VERMILION, BLUE, GREEN, BLACK), strict=True))
TRIAL_COLOURS = (BLUE, ORANGE, GREEN)
"""Of the paper's three trials."""

READING = "$d_r$, reading since contact (mm)"
MEASURED = "measured $e_1'$ (px)"
DISTANCE = "$d$, tip to wall along the beam (mm)"
ECCENTRICITY = "eccentricity $c$ (mm)"

_SHADES = dict(zip(CHOSEN_DISTANCES_MM, ("#A6CEE3", SKY, BLUE, "#08306B"), strict=True))


def pinhole_title(z_f_mm: float) -> str:
    """The pinhole's height, for titles and legends."""
    return "telecentric" if np.isinf(z_f_mm) else f"$z_F$ = {z_f_mm:g} mm"


def model_error_figure(
    analytic: pd.DataFrame,
    rendered: pd.DataFrame,
    *,
    models: Sequence[str] = COMPARED,
) -> Figure:
    """Signed error against c: a row for each pinhole and azimuth, a column for each model."""
    tilted = analytic.incidence_deg.max()
    leaning = analytic[analytic.incidence_deg == tilted]
    square = analytic[analytic.incidence_deg != tilted]

    def draw(axes: Axes, view: tuple[float, float], model: str) -> None:
        height, azimuth = view
        limit_lines(axes, ACCEPTABLE_ERROR_MM)
        for d, colour in _SHADES.items():
            for errors, style in (
                (square, {"ls": ":"}),
                (leaning, {"label": f"exact contour, $d$ = {d:g} mm"}),
                (rendered, {"ls": "", "marker": "o", "ms": 3.5}),
            ):
                here = (errors.model == model) & (errors.z_f_mm == height)
                if errors is not square:
                    here &= (errors.incidence_deg == tilted) & (errors.azimuth_deg == azimuth)
                shown = errors[here & ((errors.d_mm - d).abs() < 1e-6)]
                axes.plot(shown.c_mm, shown.error_mm, color=colour, **style)

    return small_multiples(
        draw,
        rows=list(dict.fromkeys(zip(leaning.z_f_mm, leaning.azimuth_deg, strict=True))),
        columns=models,
        title=lambda view, model: f"{model}\n{pinhole_title(view[0])}, azimuth {view[1]:g}°",
        x=ECCENTRICITY,
        y="estimate − $d$ (mm)",
        sharex=True,
        sharey="row",
    )
