"""Labels and colours of the models, and their errors against eccentricity."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from benchmarks.evaluation.model_error import COMPARED, ModelError
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
    analytic: Sequence[ModelError],
    rendered: Sequence[ModelError],
    *,
    models: Sequence[str] = COMPARED,
) -> Figure:
    """Signed error against c: a row for each pinhole and azimuth, a column for each model."""
    *square, tilted = sorted({e.incidence_deg for e in analytic})

    def draw(axes: Axes, view: tuple[float, float], model: str) -> None:
        height, azimuth = view
        limit_lines(axes, ACCEPTABLE_ERROR_MM)
        for d, colour in _SHADES.items():
            for errors, style in (
                ([e for e in analytic if e.incidence_deg in square], {"ls": ":"}),
                (leaning(analytic, azimuth), {"label": f"exact contour, $d$ = {d:g} mm"}),
                (leaning(rendered, azimuth), {"ls": "", "marker": "o", "ms": 3.5}),
            ):
                shown = [
                    e
                    for e in errors
                    if (e.model, e.z_f_mm) == (model, height) and abs(e.d_mm - d) < 1e-6
                ]
                x, y = [e.c_mm for e in shown], [e.error_mm for e in shown]
                axes.plot(x, y, color=colour, **style)

    def leaning(errors: Sequence[ModelError], azimuth: float) -> list[ModelError]:
        return [e for e in errors if (e.incidence_deg, e.azimuth_deg) == (tilted, azimuth)]

    views = [(e.z_f_mm, e.azimuth_deg) for e in analytic if e.incidence_deg == tilted]
    return small_multiples(
        draw,
        rows=list(dict.fromkeys(views)),
        columns=models,
        title=lambda view, model: f"{model}\n{pinhole_title(view[0])}, azimuth {view[1]:g}°",
        x=ECCENTRICITY,
        y="estimate − $d$ (mm)",
        sharex=True,
        sharey="row",
    )
