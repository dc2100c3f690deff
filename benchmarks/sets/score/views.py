"""Views of a score: tables on the terminal, and the figure of errors and misses by condition."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter, StrMethodFormatter
from rich.table import Table

from benchmarks.reporting import BLUE, GREEN, GREY, ORANGE, PURPLE, SKY, VERMILION, grouped, rows_of
from benchmarks.sets.score.images import ALL, CONDITIONS
from benchmarks.sets.score.judging import MAIN, Score, z_scores
from estimator.files import in_figure, in_terminal

# Tables on the terminal.

_MOST_ESTIMATORS = 4  # with two columns each


def tables(result: Score) -> list[Table]:
    """Outcomes and errors of all images, calibration of σ, and the main quantity by condition.

    The last table is left out if a terminal is too narrow for all estimators; the page has it.
    """
    counts = result.counts[result.counts.condition == ALL]
    errors = rows_of(
        result.errors[result.errors.condition == ALL].sort_values(
            "estimator", kind="stable", key=lambda names: names.map([*result.judged].index)
        )
    )
    visible = ("spot visible", "found", "missed", "false spots")
    hidden = ("hidden", "found although hidden", "left out")
    images = _table("Images", "estimator", "images", *visible, *hidden)
    for _, name, _, _, *own in counts.itertuples(name=None):
        images.add_row(in_terminal(name), *map(str, (*own, result.left_out[name])))
    title = f"Errors of the found spots ({result.against}), with 95 % intervals in brackets"
    columns = ("estimator", "quantity", "n", "bias", "RMSE", "median |e|", "largest")
    sizes = _table(title, *columns, left=2)
    for row in errors:
        sizes.add_row(
            in_terminal(row.estimator),
            row.quantity,
            str(row.n),
            _number(row.bias, signed=True),
            _rmse(row),
            _number(row.median_abs),
            _number(row.max_abs),
        )
    title = "Errors divided by the estimator's σ; ideal: 0 ± 1, 0.68, 0.95"
    sigmas = _table(title, "estimator", "quantity", "n", "e/σ", "within σ", "within 2σ", left=2)
    for row in errors:
        if row.n_sigma > 1:
            sigmas.add_row(
                in_terminal(row.estimator),
                row.quantity,
                str(row.n_sigma),
                f"{row.z_mean:+.2f} ± {row.z_std:.2f}",
                _part(row.within_1_sigma, row.within_1_low, row.within_1_high),
                _part(row.within_2_sigma, row.within_2_low, row.within_2_high),
            )
    found = [images, sizes, sigmas]
    return [*found, _conditions(result)] if len(result.judged) <= _MOST_ESTIMATORS else found


def _conditions(result: Score) -> Table:
    table = _table(f"RMSE of {MAIN}, and missed images", "condition", "group", left=2)
    for name in result.judged:
        table.add_column(in_terminal(name), justify="right")
        table.add_column("missed", justify="right")
    last = ""
    for (condition, group), of in grouped(result.by_condition, "condition", "group"):
        if condition != last:
            table.add_section()
        row = {own.estimator: own for own in rows_of(of)}
        cells = [cell for name in result.judged for cell in _group_cells(row.get(name))]
        table.add_row("" if condition == last else condition, in_terminal(group), *cells)
        last = condition
    return table


def _group_cells(row: Any) -> tuple[str, str]:
    if row is None:
        return "", ""
    missed = f"{row.missed} of {row.visible}" if row.visible else ""
    return _rmse(row), missed


def _table(title: str, *columns: str, left: int = 1) -> Table:
    table = Table(title=title, title_justify="left", title_style="bold")
    for index, column in enumerate(columns):
        table.add_column(column, justify="left" if index < left else "right")
    return table


def _number(value: float, *, signed: bool = False) -> str:
    return "" if math.isnan(value) else f"{value:{'+' if signed else ''}.3f}"


def _rmse(row: Any) -> str:
    if math.isnan(row.rmse_low):
        return _number(row.rmse)
    return f"{row.rmse:.3f} [{row.rmse_low:.3f}, {row.rmse_high:.3f}]"


def _part(part: float, low: float, high: float) -> str:
    return f"{part:.2f} [{low:.2f}, {high:.2f}]"


# The figure.

_COLOURS = (VERMILION, BLUE, GREEN, ORANGE, PURPLE, SKY)
_MARKERS = "os^D"  # one for each round through the colours
_MOST_COLUMNS = 5
_PANEL_IN = (2.4, 3.8)
_WIDEST_Z = 4.0


def score_figure(result: Score) -> Figure:
    """Per condition the RMSE and the missed fraction of visible spots; last, calibration of σ."""
    of_all = result.counts.merge(
        result.errors[result.errors.quantity == MAIN],
        "left",
        on=["estimator", "condition", "group"],
    )
    shown = result.by_condition
    shown = of_all[of_all.condition == ALL] if shown.empty else shown
    # Groups without a visible spot are omitted.
    shown = shown[shown.groupby(["condition", "group"]).visible.transform("max") > 0]
    panels = dict(grouped(shown, "condition"))
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
        upper.set_title("all images" if condition == ALL else CONDITIONS[condition].title)
        if column == 0:
            upper.set_ylabel("RMSE of $e_1'$ (px)")
            lower.set_ylabel("missed (%)")
    _scale_to_decades(figure.axes[0], shown.rmse[shown.rmse > 0])
    row, column = 2 * (len(panels) // columns), len(panels) % columns
    _draw_calibration(figure.add_subplot(grid[row : row + 2, column]), result)
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=min(len(labels), 7))
    return figure


def _draw_condition(upper: Axes, lower: Axes, result: Score, groups: pd.DataFrame) -> None:
    names = list(dict.fromkeys(groups.group))
    places = np.arange(len(names))
    width = 0.7 / len(result.judged)
    for index, (name, colour) in enumerate(zip(result.judged, _colours(result), strict=True)):
        marker = _MARKERS[index // len(_COLOURS) % len(_MARKERS)]
        x = places + (index - (len(result.judged) - 1) / 2) * width
        own = groups[groups.estimator == name].set_index("group").reindex(names)
        upper.plot(x, own.rmse, marker, ms=4, color=colour, label=in_figure(name))
        upper.vlines(x, own.rmse_low, own.rmse_high, color=colour, lw=1)
        lower.bar(x, 100 * own.missed / own.visible, width, color=colour)
    upper.tick_params(labelbottom=False)
    lower.set_xticks(
        places, [*map(in_figure, names)], rotation=35, ha="right", rotation_mode="anchor"
    )
    lower.set_xlim(-0.6, len(names) - 0.4)
    lower.set_ylim(0, 100)


def _scale_to_decades(axes: Axes, shown: pd.Series) -> None:
    """Scale the axis to whole decades, so that every panel has numbered ticks."""
    axes.set_yscale("log")
    low, high = np.log10([shown.min(), shown.max()]) if len(shown) else (0.0, 0.0)
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
