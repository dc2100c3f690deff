"""Style, small multiples and files of figures."""

from __future__ import annotations

import base64
import io
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, TypeVar

from matplotlib.axes import Axes
from matplotlib.figure import Figure

# Palette of Okabe and Ito, which colour-blind readers can distinguish.
BLACK, ORANGE, SKY, GREEN = "#000000", "#E69F00", "#56B4E9", "#009E73"
BLUE, VERMILION, PURPLE, GREY = "#0072B2", "#D55E00", "#CC79A7", "#8A8A8A"

STYLE: dict[Any, Any] = {
    "font.family": "DejaVu Sans",
    "font.size": 9,
    "axes.titlesize": 9,
    "axes.titlelocation": "left",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#E4E4E4",
    "grid.linewidth": 0.6,
    "lines.linewidth": 1.3,
    "legend.frameon": False,
    "legend.fontsize": 8,
    "figure.dpi": 150,
    "savefig.dpi": 150,
    "savefig.facecolor": "white",
    "svg.hashsalt": "eyespot",  # the same data give the same file
}
"""For `matplotlib.rc_context`."""

_WIDTH_IN = 10.0
_LEGEND_IN = 0.5
_PANEL_IN = 2.7

R = TypeVar("R")
C = TypeVar("C")


def small_multiples(
    draw: Callable[[Axes, R, C], None],
    *,
    rows: Sequence[R],
    columns: Sequence[C],
    title: Callable[[R, C], str] | None = None,
    x: str | Callable[[C], str],
    y: str | Callable[[R], str],
    height: float = _PANEL_IN,
    legend_columns: int = 4,
    **shared: Any,
) -> Figure:
    """A grid of panels, one for each pair of a row and a column.

    Args:
        rows: keys of the rows; [""] for a single row.
        columns: keys of the columns; [""] for a single column.
        title: title of a panel; by default the row and the column.
        x: label of the axis below the last row, the same for all or by column.
        y: label of the axis left of the first column, the same for all or by row.
        height: height of a panel, inches.
        legend_columns: number of columns of the legend below the panels; 0 for no legend.
        shared: `sharex` and `sharey` of `Figure.subplots`.
    """
    figure = Figure(
        figsize=(_WIDTH_IN, height * len(rows) + _LEGEND_IN * bool(legend_columns)),
        layout="constrained",
    )
    grid = figure.subplots(len(rows), len(columns), squeeze=False, **shared)
    for line, row in zip(grid, rows, strict=True):
        for axes, column in zip(line, columns, strict=True):
            names = ", ".join(str(key) for key in (row, column) if key != "")
            axes.set_title(title(row, column) if title else names)
            draw(axes, row, column)
        line[0].set_ylabel(y if isinstance(y, str) else y(row))
    for axes, column in zip(grid[-1], columns, strict=True):
        axes.set_xlabel(x if isinstance(x, str) else x(column))
    if legend_columns:
        labelled = {
            label: handle
            for axes in grid.flat
            for handle, label in zip(*axes.get_legend_handles_labels(), strict=True)
        }
        handles, labels = labelled.values(), labelled.keys()
        figure.legend(handles, labels, loc="outside lower center", ncols=legend_columns)
    return figure


def limit_lines(axes: Axes, *limits: float) -> None:
    """Zero, and dashed lines at both signs of each limit."""
    axes.axhline(0, color=GREY, lw=0.8)
    for limit in limits:
        for sign in (-1, 1):
            axes.axhline(sign * limit, color=VERMILION, lw=0.8, ls="--")


def save_figure(figure: Figure, path: Path, *, inline: str = "svg") -> str:
    """Write PNG and SVG; returns the figure as a data URI, of `inline` "svg" or "jpeg"."""
    figure.savefig(path.with_suffix(".png"), pil_kwargs={"compress_level": 1})
    figure.set_layout_engine("none")  # the layout takes half of the time; do not repeat it
    # Without a date the same data give the same file.
    figure.savefig(path.with_suffix(".svg"), metadata={"Date": None})
    if inline == "svg":
        data, kind = path.with_suffix(".svg").read_bytes(), "svg+xml"
    else:
        buffer = io.BytesIO()
        figure.savefig(buffer, format="jpeg", pil_kwargs={"quality": 88})
        data, kind = buffer.getvalue(), "jpeg"
    return f"data:image/{kind};base64,{base64.b64encode(data).decode()}"
