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
    """Signed error against c: a row for each pinhole height, a column for each model."""
    *square, tilted = sorted({e.incidence_deg for e in analytic})

    def draw(axes: Axes, height: float, model: str) -> None:
        limit_lines(axes, ACCEPTABLE_ERROR_MM)
        for d, colour in _SHADES.items():
            for errors, incidences, style in (
                (analytic, square, {"ls": ":"}),
                (analytic, [tilted], {"ls": "-", "label": f"exact contour, $d$ = {d:g} mm"}),
                (rendered, None, {"ls": "", "marker": "o", "ms": 3.5}),
            ):
                shown = [
                    e
                    for e in errors
                    if (e.model, e.z_f_mm) == (model, height)
                    and abs(e.d_mm - d) < 1e-6
                    and (incidences is None or e.incidence_deg in incidences)
                ]
                x, y = [e.c_mm for e in shown], [e.error_mm for e in shown]
                axes.plot(x, y, color=colour, **style)

    return small_multiples(
        draw,
        rows=list(dict.fromkeys(e.z_f_mm for e in analytic)),
        columns=models,
        title=lambda height, model: f"{model}, {pinhole_title(height)}",
        x=ECCENTRICITY,
        y="estimate − $d$ (mm)",
        sharex=True,
        sharey="row",
    )
