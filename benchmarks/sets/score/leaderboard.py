"""The leaderboard as a page: standings, ranks by condition, and how each entry was made."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from benchmarks.reporting import (
    BLUE,
    GREY,
    VERMILION,
    Claim,
    Column,
    Picture,
    Report,
    Section,
    Table,
    grouped,
)
from benchmarks.sets.score.entries import Entry
from benchmarks.sets.score.images import ALL, CONDITIONS
from benchmarks.sets.score.judging import Score
from benchmarks.sets.score.standings import standings
from benchmarks.sets.score.views import score_figure
from estimator.files import in_figure

_WIDTH_IN, _LINE_IN, _FRAME_IN = 9.0, 0.32, 1.1
_ONE, _WIDE = 0.683, 0.950  # parts of normal errors within 1 and 1.96 sigma

_RULE = (
    "Entries are ranked by the median of the absolute error over all images in which half of the "
    "contour or more is visible. A missed image counts as an infinite error. Intervals contain "
    "95 % of 1,000 bootstrap samples of whole stacks, the same for all entries. A rank's interval "
    "shows which entries the set can distinguish."
)


class _Quantity(NamedTuple):
    name: str
    title: str
    unit: str
    digits: int


_QUANTITIES = (
    _Quantity("semi_minor_px", "Semi-minor axis e₁′", "px", 3),
    _Quantity("centre_px", "Centre", "px", 3),
    _Quantity("distance_mm", "Distance d", "mm", 4),
)


_SHOWN = {
    "rank": Column("rank"),
    "entry": Column("entry"),
    "median": Column("median |e|"),
    "ninth_decile": Column("90 % of |e|"),
    "rmse": Column("RMSE if found"),
    "missed": Column("missed"),
    "false_spots": Column("false spots"),
    "within_1_sigma": Column("within 1 σ"),
    "within_196_sigma": Column("within 1.96 σ"),
    "over_bound": Column("error / bound"),
    "ms_per_frame": Column("ms per frame"),
}
_MADE = {name: Column(name) for name in ("entry", "command", "versions", "seed")}


def leaderboard(result: Score, entries: Mapping[str, Entry], *, name: str) -> Report:
    """The report of a leaderboard.

    Raises:
        InputError: the entries cover no image together.
    """
    made = pd.DataFrame(
        {
            "entry": entry.name,
            "ms_per_frame": math.nan if entry.ms_per_frame is None else entry.ms_per_frame,
            "command": entry.command,
            "versions": entry.versions,
            "seed": entry.seed,
        }
        for entry in entries.values()
    )
    ranked = {
        quantity: found.merge(made, on="entry")
        for quantity in _QUANTITIES
        if not (found := standings(result.judged, quantity.name)).empty
    }
    totals = {quantity: found[found.condition == ALL] for quantity, found in ranked.items()}
    shown = {quantity: _shown(quantity, total) for quantity, total in totals.items()}
    data: dict[str, pd.DataFrame | None] = {}
    if ranked:
        data["standings.csv"] = next(iter(shown.values()))
    rows = [found.assign(quantity=quantity.name) for quantity, found in ranked.items()]
    if rows:
        table = pd.concat(rows, ignore_index=True)
        table.insert(0, "quantity", table.pop("quantity"))
        table = table.drop(columns=["false_spots_low", "false_spots_high"])
        data["leaderboard.csv"] = table[table.condition == ALL]
        data["leaderboard_by_condition.csv"] = table
    return Report(
        title=f"Leaderboard of {name}",
        lead=f"{len(entries)} entries, compared with the true ellipse {result.against}. {_RULE}",
        claims=[_best(quantity, total) for quantity, total in totals.items()],
        sections=[
            *(_section(quantity, total, shown[quantity]) for quantity, total in totals.items()),
            *(_by_condition(quantity, found) for quantity, found in ranked.items()),
            Section(
                "Errors by condition",
                Picture(
                    "by_condition",
                    score_figure(result),
                    "Errors of the found spots, and the part of the visible spots that was missed.",
                    "score.csv",
                ),
            ),
            Section(
                "How the entries were made",
                Table.of(
                    made, _MADE, "As the entries state it in entry.json.", data="leaderboard.csv"
                ),
            ),
        ],
        data=data | {"score.csv": None},
    )


def _best(quantity: _Quantity, total: pd.DataFrame) -> Claim:
    first = total.iloc[0]
    return Claim(
        name=quantity.title,
        sentence="{entry} has the least median error: {value} {unit}. It misses {missed:.1f} % of "
        "{visible:d} visible spots.",
        value=first["median"],
        numbers={
            "value": _interval(first, "median", quantity.digits),
            "entry": first.entry,
            "unit": quantity.unit,
            "missed": 100 * first.missed,
            "visible": int(first.visible),
        },
    )


def _section(quantity: _Quantity, total: pd.DataFrame, shown: pd.DataFrame) -> Section:
    return Section(
        quantity.title,
        Table.of(
            shown,
            _SHOWN,
            f"{quantity.title} ({quantity.unit}), on {total.visible.iloc[0]} visible images; "
            "missed and within are in %, false spots per 100 images. σ as the entry states it; "
            f"ideal are {100 * _ONE:.1f} and {100 * _WIDE:.1f} %. The bound is that of Cramér and "
            "Rao for each image, for an estimator that knows the wall and the shape of the light. "
            "Times are as the entries state them, or wall times of this run.",
            data="leaderboard.csv",
        ),
        Picture(
            f"standings_{quantity.name}",
            _drawn(quantity, total),
            f"{quantity.title}: median error of all visible images, and coverage of the stated "
            "standard deviations, each with its 95 % interval.",
            "leaderboard.csv",
        ),
    )


def _shown(quantity: _Quantity, total: pd.DataFrame) -> pd.DataFrame:
    """Content of standings.csv and, without the last three columns, of the page's table."""
    digits = {name: (quantity.digits, 1.0) for name in ("median", "ninth_decile", "rmse")}
    digits |= {"over_bound": (1, 1.0)}
    percents = ("missed", "false_spots", "within_1_sigma", "within_196_sigma")
    digits |= {name: (1, 100.0) for name in percents}
    return pd.DataFrame(
        {
            **{
                name: _interval(row, name, *digits[name]) if name in digits else row[name]
                for name in [*_SHOWN, "command", "versions", "seed"]
            },
            "rank": _rank(row),
            "ms_per_frame": _number(row.ms_per_frame, 1),
        }
        for _, row in total.iterrows()
    )


def _by_condition(quantity: _Quantity, found: pd.DataFrame) -> Section:
    names = found.entry[found.condition == ALL]
    rows = []
    for (condition, group), placed in grouped(found, "condition", "group"):
        by_name = placed.set_index("entry")
        title = CONDITIONS[condition].title.replace("$", "") if condition != ALL else ALL
        cells = [_place(by_name.loc[name], quantity.digits) for name in names]
        rows.append((title, group, placed.visible.iloc[0], *cells))
    columns = [Column(text) for text in ("condition", "group", "visible", *names)]
    caption = f"Rank, and in brackets the median error ({quantity.unit}), by condition."
    table = Table(columns, rows, caption, "leaderboard_by_condition.csv")
    return Section(f"{quantity.title}: ranks by condition", table)


def _drawn(quantity: _Quantity, total: pd.DataFrame) -> Figure:
    figure = Figure(figsize=(_WIDTH_IN, _FRAME_IN + _LINE_IN * len(total)), layout="constrained")
    left, right = figure.subplots(1, 2, sharey=True)
    _points(left, total, "median", BLUE, "median")
    if (total["median"] > 0).any():
        left.set_xscale("log")
    left.set(xlabel=f"median |e| ({quantity.unit})")
    left.set_yticks(np.arange(len(total)), [in_figure(name) for name in total.entry])
    left.set_ylim(len(total) - 0.5, -0.5)
    for name, ideal, colour, label in (
        ("within_1", _ONE, BLUE, "within 1 σ"),
        ("within_196", _WIDE, VERMILION, "within 1.96 σ"),
    ):
        right.axvline(100 * ideal, color=GREY, ls="--", lw=0.8)
        _points(right, total, f"{name}_sigma", colour, label, scale=100.0)
    right.set(xlabel="errors within the stated σ (%)", xlim=(0, 102))
    right.legend(loc="best")
    return figure


def _points(
    axes: Axes, total: pd.DataFrame, name: str, colour: str, label: str, *, scale: float = 1.0
) -> None:
    ends = name.removesuffix("_sigma")
    values = total[[name, f"{ends}_low", f"{ends}_high"]].to_numpy(float) * scale
    places = np.arange(len(total))
    shown = np.isfinite(values[:, 0])
    axes.plot(values[shown, 0], places[shown], "o", color=colour, label=label)
    whole = np.isfinite(values).all(axis=1)
    axes.hlines(places[whole], values[whole, 1], values[whole, 2], color=colour)


def _interval(row: Any, name: str, digits: int, scale: float = 1.0) -> str:
    """A figure with its interval, such as "0.021 [0.019, 0.024]"."""
    ends = name.removesuffix("_sigma")
    value, low, high = (
        _number(row[key] * scale, digits) for key in (name, f"{ends}_low", f"{ends}_high")
    )
    return value if math.isnan(row[f"{ends}_low"]) else f"{value} [{low}, {high}]"


def _number(value: float, digits: int) -> str:
    if math.isnan(value):
        return "–"
    return "∞" if math.isinf(value) else f"{value:.{digits}f}"


def _rank(row: Any) -> str:
    value, low, high = (f"{row[key]:.0f}" for key in ("rank", "rank_low", "rank_high"))
    return value if math.isnan(row["rank_low"]) or low == high else f"{value} [{low}–{high}]"


def _place(row: Any, digits: int) -> str:
    if math.isnan(row["median"]):
        return "–"
    return f"{row['rank']:.0f} ({_number(row['median'], digits)})"
