"""A report: claims, sections with tables and pictures, CSV files; one HTML page."""

import base64
import io
import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from numbers import Integral
from pathlib import Path
from typing import Any, Literal, NamedTuple, TypeVar

import jinja2
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse
from matplotlib.ticker import LogLocator, NullLocator

from eyespot.formats.report_page import PALETTE, UNITS, templates, unit_at_end
from eyespot.formats.report_page import STYLE as STYLE_OF_FITS

# Style, small multiples and files of figures.

BLUE, VERMILION, GREEN, ORANGE, PURPLE, SKY, BLACK = PALETTE
GREY = "#8A8A8A"

STYLE = STYLE_OF_FITS | {
    "font.family": "DejaVu Sans",
    "font.size": 9,
    "axes.titlesize": 9,
    "lines.linewidth": 1.3,
    "legend.fontsize": 8,
    "figure.dpi": 150,
    "savefig.dpi": 150,
    "savefig.facecolor": "white",
}
"""For `matplotlib.rc_context`."""

_WIDTH_IN = 10.0
_LEGEND_IN = 0.5
_PANEL_IN = 2.7

C = TypeVar("C")


def small_multiples(
    draw: Callable[[Axes, Any, C], None],
    *,
    rows: Sequence[Any] = ("",),
    columns: Sequence[C],
    title: Callable[[Any, C], str] | None = None,
    x: str | Callable[[C], str] = "",
    y: str | Callable[[Any], str] = "",
    height: float = _PANEL_IN,
    legend_columns: int = 4,
    **shared: Any,
) -> Figure:
    """A grid of panels, one for each pair of a row and a column.

    Args:
        rows: keys of the rows, as `columns` those of the columns; by default a single row.
        title: title of a panel; by default the row and the column.
        x: label of the axis below the last row, the same for all or by column.
        y: label of the axis left of the first column, the same for all or by row.
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
            if axes.get_yscale() == "log":  # plain numbers instead of powers of ten
                axes.yaxis.set_major_locator(LogLocator(subs=(1, 3)))
                axes.yaxis.set_major_formatter("{x:g}")
                axes.yaxis.set_minor_locator(NullLocator())
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


def draw_spots(
    axes: Axes, image: np.ndarray, bits: int, *spots: tuple[Sequence[float], dict[str, Any]]
) -> None:
    """Draw an image with ellipses, each with its look; of more than 8 bits without the lowest ones.

    Ellipses are x, y, semi-major and semi-minor axis (px) and angle (rad).
    """
    axes.imshow((image >> (bits - 8)).astype(np.uint8), cmap="gray", vmin=0, vmax=255)
    for (x, y, major, minor, angle), look in spots:
        style = {"angle": math.degrees(angle), "fill": False} | look
        axes.add_patch(Ellipse((x, y), 2 * major, 2 * minor, **style))
    axes.set_axis_off()


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


# Numbers as text.


def typeset(text: str) -> str:
    """A text with true minus signs, none for zero, and dashes for NaN and infinity."""
    text = re.sub(r"[+-]?\b(nan|inf)\b", "–", text)
    text = re.sub(r"(?<![\w.])[+-](?=0(\.0+)?(?!\.?\d))", "", text)
    return re.sub(r"(?<![\w.])-(?=[\d.])", "−", text)


def number(value: float, digits: int = 2) -> str:
    """A rounded value, typeset."""
    return typeset(f"{value:.{digits}f}")


def listed(values: float | Iterable[float], spec: str) -> str:
    """Numbers of a sentence, separated by commas."""
    return ", ".join(format(value, spec) for value in np.atleast_1d(np.asarray(values)).tolist())


# Parts of a report.


@dataclass(frozen=True, kw_only=True)
class Claim:
    """One result of a run, and whether it is as expected.

    Attributes:
        name: subject of the claim, the same in every run.
        sentence: what was found, with its numbers in ASCII; `text` typesets them.
        value: what was measured; each of several values must lie from `low` to `high`.
    """

    name: str
    sentence: str
    value: float | tuple[float, ...] = math.nan
    low: float = -math.inf
    high: float = math.inf

    @property
    def holds(self) -> bool | None:
        """Whether all values lie within the bounds; None for a claim without bounds."""
        if math.isinf(self.low) and math.isinf(self.high):
            return None
        values = self.value if isinstance(self.value, tuple) else (self.value,)
        return all(self.low <= value <= self.high for value in values)

    @property
    def text(self) -> str:
        """The sentence, typeset."""
        return typeset(self.sentence)


class Column(NamedTuple):
    """How a column of a table is shown.

    Attributes:
        heading: with the unit.
        scale: factor from the value to the heading's unit.
    """

    heading: str
    digits: int = 3
    scale: float = 1.0

    def cell(self, value: Any) -> str:
        """The value as text: texts and integers unchanged, floats rounded."""
        if isinstance(value, str | Integral):
            return str(value)
        return number(value * self.scale, self.digits)


_SYMBOLS = {"delta k": "δk", "r squared": "R²", "rmse": "RMSE", "z f": "z_F"} | {
    "numerical aperture": "NA"
}


def column_of(name: str, values: pd.Series) -> Column:
    """A column headed as in its CSV file, with four digits of its largest value."""
    unit = unit_at_end(name)
    heading = name.removesuffix(f"_{unit}").replace("_", " ")
    for words, symbol in _SYMBOLS.items():
        heading = heading.replace(words, symbol)
    digits = 0
    if values.dtype.kind == "f":
        sizes = values[np.isfinite(values)].abs()
        if (sizes % 1 > 0).any():
            digits = int(np.clip(3 - math.floor(math.log10(sizes.max())), 0, 6))
            while digits and (sizes.round(digits) == sizes.round(digits - 1)).all():
                digits -= 1
    return Column(f"{heading}, {UNITS[unit]}" if unit else heading, digits)


class Table:
    """The named columns of a frame as texts, by default headed as in its CSV file (`column_of`)."""

    def __init__(
        self,
        frame: pd.DataFrame,
        columns: Mapping[str, Column] | Iterable[str],
        caption: str,
        data: str = "",
    ) -> None:
        if not isinstance(columns, Mapping):
            columns = {name: column_of(name, frame[name]) for name in columns}
        self.columns, self.caption, self.data = list(columns.values()), caption, data
        values = [frame[name].tolist() for name in columns]
        texts = ([c.cell(v) for v in of] for c, of in zip(self.columns, values, strict=True))
        self.cells = list(zip(*texts, strict=True))
        # Class of each column's cells: numbers are aligned to the right.
        self.alignments = ["" if all(isinstance(v, str) for v in of) else "n" for of in values]


class Picture(NamedTuple):
    """A figure of the report, written as figures/NAME.png and .svg.

    Its caption begins with its message; "z_F" and "d_r" get their subscripts. `inline` is the
    format in the page: frames with a camera's noise are ten times smaller as JPEG.
    """

    name: str
    figure: Figure
    caption: str
    data: str = ""
    inline: Literal["svg", "jpeg"] = "svg"


class Section:
    """A heading with paragraphs, tables and pictures below it, in order."""

    def __init__(self, title: str, *parts: str | Table | Picture) -> None:
        self.title, self.parts = title, parts


@dataclass(frozen=True, kw_only=True)
class Report:
    """The report of a study.

    Attributes:
        answer: to the title's question, in a sentence.
        lead: the method, in a sentence or two.
        first: what people look at first: a strip of frames if there is one, a figure of at most
            four panels, a table of at most eight rows.
        claims: checks and further results; a table at the end.
        data: CSV files to write, by name, with units in the columns' names; None is a file that the
            study has already written.
    """

    title: str
    answer: str = ""
    lead: str
    first: Sequence[str | Table | Picture] = ()
    claims: Sequence[Claim]
    sections: Sequence[Section] = ()
    data: Mapping[str, pd.DataFrame | None] = field(default_factory=dict)


def rows_of(frame: pd.DataFrame) -> list[Any]:
    """The rows of a frame as named tuples."""
    return list(frame.itertuples(index=False))


def where(frame: pd.DataFrame, **values: Any) -> pd.DataFrame:
    """The rows of a frame whose columns have these values."""
    for column, value in values.items():
        frame = frame[frame[column] == value]
    return frame


def grouped(frame: pd.DataFrame, *columns: str) -> list[tuple[Any, pd.DataFrame]]:
    """Parts of a frame by the values of columns, in the order of their first rows."""
    return list(frame.groupby(columns[0] if len(columns) == 1 else list(columns), sort=False))


# The page.

_MOST_ROWS = 8
"""Rows of a table in the page; its CSV file has all."""


def environment() -> jinja2.Environment:
    """The templates of pages and cards."""
    made = templates("eyespot.benchmarks")
    made.globals |= {"number": number, "most_rows": _MOST_ROWS}
    made.tests["table"] = lambda part: isinstance(part, Table)
    made.tests["picture"] = lambda part: isinstance(part, Picture)
    return made


def write_page(
    folder: Path,
    report: Report,
    *,
    command: str,
    versions: Mapping[str, str],
    summary_file: str = "summary.json",
    study: Any = None,
    scene_toml: str = "",
) -> None:
    """Write report.html, the report's CSV files, and its figures in figures/.

    Args:
        report: its figures use the style of the caller's `rc_context`.
        versions: of the packages that the results depend on.
        summary_file: file for programs, which the caller writes.
        study: the run, if it is one of a study, and the scene that it starts from.
    """
    for name, frame in report.data.items():
        if frame is not None:
            frame.to_csv(folder / name, index=False, lineterminator="\n", errors="backslashreplace")
    (folder / "figures").mkdir()
    parts = [*report.first, *(part for section in report.sections for part in section.parts)]
    images = {
        part.name: save_figure(part.figure, folder / "figures" / part.name, inline=part.inline)
        for part in parts
        if isinstance(part, Picture)
    }
    about = {"study": study, "scene_toml": scene_toml, "command": command, "versions": versions}
    html = (
        environment()
        .get_template("page.html.j2")
        .render(report=report, images=images, summary_file=summary_file, **about)
    )
    (folder / "report.html").write_text(html, encoding="utf-8", errors="backslashreplace")
