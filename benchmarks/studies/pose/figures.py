"""Pictures of the study of poses: errors beside their bounds and the best reported figures."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from benchmarks.studies.pose import analytic
from benchmarks.studies.pose.errors import (
    ASKED_DISTANCE_MM,
    KNOWN,
    NAMES,
    PRIOR,
    REPORTED,
    PoseError,
    rms,
    some_of,
)
from benchmarks.studies.validate import BLACK, BLUE, GREY, VERMILION, figures

_COLOURS = {1: BLUE, 3: VERMILION}
_ASIDE = 0.1
"""Spots of one eccentricity are drawn side by side, by their distance."""


def by_incidence(rows: Sequence[PoseError]) -> Figure:
    """Errors of tip and axis against the incidence, for the first row's pinhole."""
    page = Figure(figsize=(10.0, 4.2), layout="constrained")
    height = rows[0].z_f_mm
    for axes, (name, error, limit, unit) in zip(
        page.subplots(1, 2),
        (
            ("tip", "tip_error_mm", "tip_bound_mm", "mm"),
            ("axis", "axis_error_deg", "axis_bound_deg", "°"),
        ),
        strict=True,
    ):
        for spots, colour in _COLOURS.items():
            for source, marker in (("analytic", "."), ("rendered", "x")):
                some = [r for r in some_of(rows, source, spots, PRIOR) if not r.mirrored]
                some = [row for row in some if row.z_f_mm == height]
                x = [row.incidence_deg for row in some]
                y = [getattr(row, error) for row in some]
                axes.plot(
                    x,
                    y,
                    ls="",
                    marker=marker,
                    ms=4 if marker == "." else 6,
                    color=colour,
                    alpha=0.45 if marker == "." else 1.0,
                    label=f"{NAMES[spots]}, {source}",
                )
            axes.plot(*_binned(rows, spots, limit), color=colour, lw=1.6)
            axes.axhline(REPORTED[spots][unit == "°"], color=colour, ls=":", lw=1.0)
        axes.set(yscale="log", xlabel="incidence (°)", ylabel=f"error of the {name} ({unit})")
    page.legend(*page.axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=4)
    return page


def _binned(rows: Sequence[PoseError], spots: int, limit: str) -> tuple[np.ndarray, list[float]]:
    """Root mean square of the analytic bounds over parts of the incidence's range."""
    edges = np.linspace(*analytic.INCIDENCE_DEG, 6)
    some = some_of(rows, "analytic", spots, PRIOR)
    parts = [
        [getattr(row, limit) for row in some if low <= row.incidence_deg < high]
        for low, high in itertools.pairwise(edges)
    ]
    return 0.5 * (edges[:-1] + edges[1:]), [rms(part) for part in parts]


def known_axis(rows: Sequence[PoseError]) -> Figure:
    """Errors of the distance on rendered frames, the axis known, against c."""
    page = Figure(figsize=(10.0, 3.2), layout="constrained")
    axes = page.subplots()
    some = some_of(rows, "rendered", 1, KNOWN)
    middle = float(np.mean([row.d_mm for row in some]))
    axes.axhline(0, color=GREY, lw=0.8)
    for limit in (-ASKED_DISTANCE_MM, ASKED_DISTANCE_MM):
        axes.axhline(1e3 * limit, color=BLACK, lw=0.8, ls="--")
    axes.errorbar(
        [row.c_mm + _ASIDE * (row.d_mm - middle) for row in some],
        [1e3 * row.distance_error_mm for row in some],
        yerr=[1e3 * row.sigma_distance_mm for row in some],
        fmt="x",
        capsize=2,
        color=BLUE,
    )
    axes.set(xlabel=figures.ECCENTRICITY, ylabel="error of $d$ (µm)")
    return page
