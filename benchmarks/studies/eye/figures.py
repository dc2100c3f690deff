"""Figures of the study of eyes."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from benchmarks.evaluation import ECCENTRICITY
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
from benchmarks.studies.eye.findings import LIMITS_MM, EyeFindings
from benchmarks.studies.eye.recipes import Recipe

_STYLES = {
    Recipe.PLANAR: (VERMILION, ":"),
    Recipe.SMALL_PLANE: (VERMILION, "-"),
    Recipe.STEREOGRAPHIC: (VERMILION, "--"),
    Recipe.PARAXIAL: (ORANGE, "-"),
    Recipe.LOCAL: (PURPLE, "-"),
    Recipe.FITTED: (SKY, "-"),
    Recipe.EXACT_SCHEMATIC: (GREEN, "--"),
    Recipe.AREA_SCHEMATIC: (GREEN, "-"),
    Recipe.AREA: (BLUE, "-"),
}
"""Colour and line; recipes that know the same have one colour."""
_SMALLEST_MM, _LARGEST_MM = 0.002, 8.0


def error_figure(findings: EyeFindings) -> Figure:
    """95 % of the eyes' largest errors against c: a row for each path, a column for the tilts."""
    curves = {row[:4]: row.p95_mm for row in findings.summaries()}

    def draw(axes: Axes, path: str, tilt: str) -> None:
        low, middle, high = np.quantile(findings.fields[path][findings.random], [0.05, 0.5, 0.95])
        axes.axvspan(low, high, color="#EEEEEE", zorder=0)
        axes.axvline(middle, color=GREY, lw=0.8, label="largest c that a 7 mm pupil shows")
        for limit in LIMITS_MM:
            axes.axhline(limit, color=BLACK, lw=0.8, ls="--")
        for recipe, (colour, line) in _STYLES.items():
            values = [curves[path, recipe, tilt, float(c)] for c in findings.eccentricities]
            axes.plot(
                findings.eccentricities, values, line, marker="o", ms=3, color=colour, label=recipe
            )
        axes.set_yscale("log")
        axes.set_xlim(-0.2, findings.eccentricities[-1] + 0.2)
        axes.set_ylim(_SMALLEST_MM, _LARGEST_MM)

    return small_multiples(
        draw,
        rows=[*findings.paths],
        columns=["square", "any"],
        title=lambda path, tilt: f"{path}; {'square' if tilt == 'square' else 'tilted up to 30°'}",
        x=ECCENTRICITY,
        y="95 % of eyes, |error| (mm)",
        height=2.5,
        sharex=True,
        sharey=True,
    )


def kappa_figure(findings: EyeFindings) -> Figure:
    """The fitted pinhole of every random eye against its field, by path."""
    colours = dict(zip(findings.paths, (BLUE, SKY, GREEN, ORANGE, PURPLE), strict=False))

    def draw(axes: Axes, _: str, __: str) -> None:
        for path, colour in colours.items():
            found = findings.paths[path]
            kappas = found.kappas[findings.random]
            axes.hist(kappas, bins=40, histtype="step", density=True, color=colour, label=path)
            axes.axvline(found.paraxial_kappa, color=colour, lw=0.8, ls=":")

    return small_multiples(
        draw, rows=[""], columns=[""], x="fitted κ (1/mm)", y="density (mm)", height=3.0
    )
