"""Pictures of the static study."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from benchmarks.evaluation import LITERAL, SUBPIXEL, TABLE_I, TABLE_II
from benchmarks.studies.static.causes import ALL, NONE, Part
from benchmarks.studies.static.run import Findings
from benchmarks.studies.validate import ALL_PLANES, BLUE, GREY, MEASURED, READING, TRIAL_COLOURS


def trials(findings: Findings) -> Figure:
    """d_r against e1' of all runs: planes and spheres (rows), by way of measuring (columns)."""
    page = Figure(figsize=(10.0, 6.4), layout="constrained")
    grid = page.subplots(2, 2, sharex=True, sharey=True)
    planes = {LITERAL.name: findings.planes[ALL], SUBPIXEL.name: findings.subpixel}
    names = [name for name in TABLE_I if name != ALL_PLANES]
    for row, by_way, trials in (
        (grid[0], planes, names),
        (grid[1], findings.spheres, list(TABLE_II)),
    ):
        for axes, (way, measured) in zip(row, by_way.items(), strict=True):
            for n, (trial, colour) in enumerate(zip(trials, TRIAL_COLOURS, strict=True)):
                spots = measured.semi_minor[:, n].ravel(), measured.readings[:, n].ravel()
                axes.plot(*spots, ".", ms=2.5, alpha=0.5, color=colour, label=trial)
            axes.set_title(way)
            axes.legend(loc="lower right", markerscale=3)
    low, high = grid[0, 0].get_ylim()
    d = np.array([max(low, 0.0), high])
    for axes in grid[0]:
        for trial, colour in zip(names, TRIAL_COLOURS, strict=True):
            line = TABLE_I[trial]
            axes.plot((d - line.b) / line.delta_k, d, color=colour, lw=0.8)
    for axes in grid[1]:
        axes.set_xlabel(MEASURED)
    for axes in grid[:, 0]:
        axes.set_ylabel(READING)
    return page


def causes(parts: Sequence[Part]) -> Figure:
    """Parts of the mean square error, of each trial's line and of all trials' line."""
    scopes = list(dict.fromkeys(part.scope for part in parts))
    page = Figure(figsize=(10.0, 3.2), layout="constrained")
    for axes, scope in zip(page.subplots(1, len(scopes)), scopes, strict=True):
        rows = [part for part in parts if part.scope == scope][::-1]
        axes.barh(
            [part.cause for part in rows],
            [1e3 * part.part_mm2 for part in rows],
            xerr=np.nan_to_num([1e3 * part.standard_error_mm2 for part in rows]),
            color=[GREY if part.cause in (NONE, ALL) else BLUE for part in rows],
            height=0.6,
        )
        pooled = scope == "all trials"
        for name, row in TABLE_I.items():
            if pooled == (name == ALL_PLANES):
                axes.axvline(1e3 * row.rmse**2, color=GREY, lw=0.8, ls=":")
        axes.set_title(f"line of {scope}")
        axes.set_xlabel("mean square error (10$^{-3}$ mm²)")
    return page
