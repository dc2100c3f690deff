"""The results of a run, and the figures of the report."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

import optics
from benchmarks.evaluation import (
    ECCENTRICITY,
    MICROSCOPE_MM,
    MODEL_COLOURS,
    largest_errors,
    pinhole_title,
)
from benchmarks.reporting import (
    BLACK,
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    PURPLE,
    SKY,
    VERMILION,
    grouped,
    small_multiples,
)
from benchmarks.studies.eccentricity.causes import CAUSES
from benchmarks.studies.eccentricity.limits import LIMITS_MM, Withdrawals
from benchmarks.studies.eccentricity.rendered import RenderedErrors
from benchmarks.studies.eccentricity.space import AXES, PINHOLES
from scenes import Scene


@dataclass(frozen=True, kw_only=True)
class EccentricityFindings:
    """What the report is made of.

    Attributes:
        scene: the study's.
        withdrawals: on exact contours, by (z_F in mm, incidence in degrees).
        limits: where models reach the limits, among the withdrawals.
        geometries: number of points in the space of geometries.
        spreads: of the errors over the space.
        sensitivities: of the errors over the space.
        within: part of the space in which each model is within the largest limit.
    """

    scene: Scene
    withdrawals: dict[tuple[float, float], Withdrawals]
    limits: pd.DataFrame
    rendered: RenderedErrors
    geometries: int
    spreads: pd.DataFrame
    sensitivities: pd.DataFrame
    within: dict[str, float]

    @property
    def analytic(self) -> pd.DataFrame:
        """Errors on exact contours of all withdrawals, with the true c."""
        errors = pd.concat([w.errors for w in self.withdrawals.values()], ignore_index=True)
        return errors[~errors.refit]

    @property
    def refits(self) -> pd.DataFrame:
        """Fits of c on exact contours."""
        return pd.concat([w.refits for w in self.withdrawals.values()], ignore_index=True)

    @property
    def heights(self) -> tuple[float, float]:
        """z_F of the pinholes that the report compares, mm."""
        return pinhole_heights(self.scene)

    def limits_of(
        self, model: str, height: float, incidence: float, *, refit: bool = False
    ) -> tuple[float, ...]:
        """c at which a model reaches each of `LIMITS_MM`, mm; NaN where it does not."""
        of = self.limits
        here = (of.model == model) & (of.refit == refit)
        return tuple(of.c_mm[here & (of.z_f_mm == height) & (of.incidence_deg == incidence)])


def pinhole_heights(scene: Scene) -> tuple[float, float]:
    """z_F of the paper's geometry, on the sphere, and of a microscope, mm."""
    return scene.phantom.radius_mm, MICROSCOPE_MM


# Figures.

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
    measured = findings.rendered.with_true_c

    def draw(axes: Axes, height: float, incidence: float) -> None:
        for limit in LIMITS_MM:
            axes.axhline(limit, color=GREY, lw=0.8, ls=":")
        exact = findings.withdrawals[height, incidence].errors
        seen = measured[(measured.z_f_mm == height) & (measured.incidence_deg == incidence)]
        for model, colour in _COLOURS.items():
            line = largest_errors(exact[(exact.model == model) & ~exact.refit])
            if model != "exact":  # right to rounding on its own contours
                axes.plot(line, color=colour, label=model)
            label = model if model == "exact" else None
            marks = largest_errors(seen[seen.model == model])
            axes.plot(marks, ls="", marker="o", ms=3.5, color=colour, label=label)
        refit = largest_errors(exact[exact.refit])
        axes.plot(refit, color=VERMILION, ls="--", label="small_plane, c fitted")
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
    refits = findings.refits
    tilted = refits[refits.incidence_deg == findings.scene.spot.incidence_deg]
    drawn = list(zip(grouped(tilted, "z_f_mm"), (GREEN, BLUE, VERMILION, BLACK), strict=False))

    def fitted(axes: Axes) -> None:
        for (height, rows), colour in drawn:
            label = pinhole_title(height)
            axes.plot(rows.c_mm, rows.fitted_c_mm, color=colour, label=label)
            axes.plot(rows.c_mm, rows.c_mm, color=GREY, lw=0.8)

    def sizes(axes: Axes) -> None:
        for (_, rows), colour in drawn:
            axes.plot(rows.c_mm, rows.largest_error_mm, color=colour)
            axes.plot(rows.c_mm, rows.largest_residual_mm, color=colour, ls="--")
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
    shares = findings.rendered.shares
    chosen = shares[(shares.d_mm - d).abs() < 1e-6]

    def draw(axes: Axes, height: float, model: str) -> None:
        here = chosen[(chosen.z_f_mm == height) & (chosen.model == model)]
        c = np.unique(here.c_mm.round(6))
        width = 0.7 * (np.diff(c).min() if c.size > 1 else 1.0)
        above, below = np.zeros(c.size), np.zeros(c.size)
        for cause, colour in _CAUSE_COLOURS.items():
            size = here.part_mm[here.cause == cause].to_numpy()
            foot = np.where(size >= 0, above, below)
            axes.bar(c, size, width, bottom=foot, color=colour, label=cause)
            above += np.maximum(size, 0.0)
            below += np.minimum(size, 0.0)
        whole = here.whole_mm[here.cause == CAUSES[0]]
        axes.plot(c, whole, ls="", marker="D", ms=4, mfc="white", mec=BLACK, label="whole")
        axes.axhline(0, color=BLACK, lw=0.6)

    return small_multiples(
        draw,
        rows=chosen.z_f_mm.unique().tolist(),
        columns=optics.MODELS,
        title=lambda height, model: f"{model}, {pinhole_title(height)}",
        x=ECCENTRICITY,
        y="part of the error (mm)",
        legend_columns=5,
        sharex=True,
    )


def spreads(findings: EccentricityFindings) -> Figure:
    """Size of the errors along every axis, over all others: a row for each pinhole."""
    every = findings.spreads

    def draw(axes: Axes, pinhole: str, axis: str) -> None:
        for model, colour in _COLOURS.items():
            here = (every.model == model) & (every.pinhole == pinhole) & (every.axis == axis)
            rows = every[here]
            if model != "exact":
                middle = 0.5 * (rows.from_value + rows.to_value)
                axes.plot(middle, rows.median_mm, color=colour, label=model)
                axes.plot(middle, rows.percentile_95_mm, color=colour, lw=0.8, ls=":")
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
