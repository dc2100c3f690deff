"""Figure of a score: errors and missed spots by condition, and calibration of σ."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter, StrMethodFormatter

from benchmarks.reporting import (
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    PURPLE,
    SKY,
    VERMILION,
)
from benchmarks.sets.score.conditions import CONDITIONS
from benchmarks.sets.score.groups import ALL, Group, Score
from benchmarks.sets.score.measures import z_scores
from benchmarks.sets.score.table import MAIN
from estimator.files import in_figure

_Panels = dict[str, dict[str, dict[str, Group]]]
"""Groups by condition, group and estimator."""

_COLOURS = (VERMILION, BLUE, GREEN, ORANGE, PURPLE, SKY)
_MARKERS = "os^D"  # one for each round through the colours
_MOST_COLUMNS = 5
_PANEL_IN = (2.4, 3.8)
_WIDEST_Z = 4.0
_TITLES = {ALL: "all images"} | {condition.name: condition.title for condition in CONDITIONS}


def score_figure(result: Score) -> Figure:
    """Per condition the RMSE and the missed fraction of visible spots; last, calibration of σ."""
    panels = _panels(result)
    blocks = math.ceil((len(panels) + 1) / _MOST_COLUMNS)
    columns = math.ceil((len(panels) + 1) / blocks)
    size = _PANEL_IN[0] * max(columns, 3), _PANEL_IN[1] * blocks
    figure = Figure(figsize=size, layout="constrained")
    grid = figure.add_gridspec(2 * blocks, columns, height_ratios=[2, 1] * blocks)
    first: tuple[Axes | None, Axes | None] = (None, None)
    for place, (condition, groups) in enumerate(panels.items()):
        row, column = 2 * (place // columns), place % columns
        upper = figure.add_subplot(grid[row, column], sharey=first[0])
        lower = figure.add_subplot(grid[row + 1, column], sharex=upper, sharey=first[1])
        first = first if place else (upper, lower)
        _draw_condition(upper, lower, result, groups)
        upper.set_title(_TITLES[condition])
        if column == 0:
            upper.set_ylabel("RMSE of $e_1'$ (px)")
            lower.set_ylabel("missed (%)")
    _draw_scale(figure.axes[0], panels)
    row, column = 2 * (len(panels) // columns), len(panels) % columns
    _draw_calibration(figure.add_subplot(grid[row : row + 2, column]), result)
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=min(len(labels), 7))
    return figure


def _panels(result: Score) -> _Panels:
    """Groups by condition; groups without a visible spot are omitted."""
    rows = result.by_condition() or {
        (ALL, ALL): {name: result.total(name) for name in result.judged}
    }
    panels: _Panels = {}
    for (condition, group), row in rows.items():
        if any(found.counts.visible for found in row.values()):
            panels.setdefault(condition, {})[group] = row
    return panels


def _draw_condition(
    upper: Axes, lower: Axes, result: Score, groups: Mapping[str, Mapping[str, Group]]
) -> None:
    places = np.arange(len(groups))
    width = 0.7 / len(result.judged)
    for index, (name, colour) in enumerate(zip(result.judged, _colours(result), strict=True)):
        marker = _MARKERS[index // len(_COLOURS) % len(_MARKERS)]
        x = places + (index - (len(result.judged) - 1) / 2) * width
        found = [row.get(name) for row in groups.values()]
        rmse, low, high = np.array([_rmse(group) for group in found]).T
        upper.plot(x, rmse, marker, ms=4, color=colour, label=in_figure(name))
        upper.vlines(x, low, high, color=colour, lw=1)
        lower.bar(x, [_missed_percent(group) for group in found], width, color=colour)
    upper.tick_params(labelbottom=False)
    lower.set_xticks(
        places, [*map(in_figure, groups)], rotation=35, ha="right", rotation_mode="anchor"
    )
    lower.set_xlim(-0.6, len(groups) - 0.4)
    lower.set_ylim(0, 100)


def _draw_scale(axes: Axes, panels: _Panels) -> None:
    """Scale the axis to whole decades, so that every panel has numbered ticks."""
    rows = (row for groups in panels.values() for row in groups.values())
    every = (_rmse(group)[0] for row in rows for group in row.values())
    shown = [value for value in every if value > 0] or [1.0]
    axes.set_yscale("log")
    low, high = (math.log10(value) for value in (min(shown), max(shown)))
    axes.set_ylim(10 ** math.floor(low), 10 ** max(math.ceil(high), math.floor(low) + 1))
    axes.yaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    axes.yaxis.set_minor_formatter(NullFormatter())


def _draw_calibration(axes: Axes, result: Score) -> None:
    """Fraction of errors within z σ, compared with a normal distribution."""
    z = np.linspace(0, _WIDEST_Z, 200)
    normal = [math.erf(value / math.sqrt(2)) for value in z]
    axes.plot(z, normal, "--", color=GREY, label="normal distribution")
    for images, colour in zip(result.judged.values(), _colours(result), strict=True):
        scores = np.abs(z_scores(images, MAIN))
        if scores.size:
            axes.plot(z, [np.mean(scores <= value) for value in z], color=colour)
    axes.set(title="errors of $e_1'$ within zσ", xlabel="z", xlim=(0, _WIDEST_Z), ylim=(0, 1))
    axes.legend(loc="best")


def _colours(result: Score) -> list[str]:
    return [_COLOURS[index % len(_COLOURS)] for index in range(len(result.judged))]


def _rmse(group: Group | None) -> tuple[float, float, float]:
    """RMSE and the ends of its interval; NaN if there are no errors."""
    errors = group.of(MAIN) if group else None
    if errors is None:
        return math.nan, math.nan, math.nan
    return errors.rmse, errors.rmse_low, errors.rmse_high


def _missed_percent(group: Group | None) -> float:
    if group is None or not group.counts.visible:
        return math.nan
    return 100 * group.counts.missed / group.counts.visible
