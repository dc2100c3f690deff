"""The leaderboard as a page: standings, ranks by condition, and how each entry was made."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Annotated, NamedTuple

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Drawing

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
    frame_of,
)
from benchmarks.sets.score.conditions import CONDITIONS
from benchmarks.sets.score.entries import Entry
from benchmarks.sets.score.figure import score_figure
from benchmarks.sets.score.groups import ALL, Score
from benchmarks.sets.score.standings import Figure, Standing, Standings, standings
from estimator.files import in_figure

_WIDTH_IN, _LINE_IN, _FRAME_IN = 9.0, 0.32, 1.1
_ONE, _WIDE = 0.683, 0.950  # parts of normal errors within 1 and 1.96 sigma
_TITLES = {condition.name: condition.title.replace("$", "") for condition in CONDITIONS}

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


class LeaderboardRow(NamedTuple):
    """A line of leaderboard.csv and of leaderboard_by_condition.csv; see `Standing`."""

    quantity: str
    condition: str
    group: str
    rank: int
    rank_low: float
    rank_high: float
    entry: str
    visible: int
    missed: float
    missed_low: float
    missed_high: float
    false_spots: float
    median: float
    median_low: float
    median_high: float
    ninth_decile: float
    ninth_decile_low: float
    ninth_decile_high: float
    rmse: float
    rmse_low: float
    rmse_high: float
    within_1_sigma: float
    within_1_low: float
    within_1_high: float
    within_196_sigma: float
    within_196_low: float
    within_196_high: float
    over_bound: float
    over_bound_low: float
    over_bound_high: float
    ms_per_frame: float
    command: str
    versions: str
    seed: str


class _Shown(NamedTuple):
    """A line of standings.csv and, without the last three, of the page's table."""

    rank: Annotated[str, Column("rank")]
    entry: Annotated[str, Column("entry")]
    median: Annotated[str, Column("median |e|")]
    ninth_decile: Annotated[str, Column("90 % of |e|")]
    rmse: Annotated[str, Column("RMSE if found")]
    missed: Annotated[str, Column("missed")]
    false_spots: Annotated[str, Column("false spots")]
    within_1_sigma: Annotated[str, Column("within 1 σ")]
    within_196_sigma: Annotated[str, Column("within 1.96 σ")]
    over_bound: Annotated[str, Column("error / bound")]
    ms_per_frame: Annotated[str, Column("ms per frame")]
    command: str
    versions: str
    seed: str


class _Made(NamedTuple):
    """How an entry was made."""

    entry: Annotated[str, Column("entry")]
    command: Annotated[str, Column("command")]
    versions: Annotated[str, Column("versions")]
    seed: Annotated[str, Column("seed")]


def leaderboard(result: Score, entries: Mapping[str, Entry], *, name: str) -> Report:
    """The report of a leaderboard.

    Args:
        result: scores of all entries.
        entries: the entries by name.
        name: name of the set.

    Raises:
        InputError: the entries cover no image together.
    """
    ranked = {
        quantity: found
        for quantity in _QUANTITIES
        if (found := standings(result.judged, quantity.name))
    }
    rows = [
        row for quantity, found in ranked.items() for row in _rows(quantity.name, found, entries)
    ]
    ranking: dict[str, pd.DataFrame | None] = {}
    if ranked:
        quantity, found = next(iter(ranked.items()))
        shown = _shown(quantity, found[ALL, ALL], entries)
        ranking["standings.csv"] = frame_of(_Shown, shown)
    return Report(
        title=f"Leaderboard of {name}",
        lead=f"{len(entries)} entries, compared with the true ellipse {result.against}. {_RULE}",
        claims=[_best(quantity, found) for quantity, found in ranked.items()],
        sections=[
            *(_section(quantity, found, entries) for quantity, found in ranked.items()),
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
            Section("How the entries were made", _made(entries)),
        ],
        data=ranking
        | {
            "leaderboard.csv": frame_of(LeaderboardRow, [r for r in rows if r.condition == ALL]),
            "leaderboard_by_condition.csv": frame_of(LeaderboardRow, rows),
            "score.csv": None,
        },
    )


def _best(quantity: _Quantity, found: Standings) -> Claim:
    first = found[ALL, ALL][0]
    return Claim(
        name=quantity.title,
        sentence="{entry} has the least median error: {value} {unit}. It misses {missed:.1f} % of "
        "{visible:d} visible spots.",
        value=first.median.value,
        numbers={
            "value": _interval(first.median, quantity.digits),
            "entry": first.entry,
            "unit": quantity.unit,
            "missed": 100 * first.missed.value,
            "visible": first.visible,
        },
    )


def _section(quantity: _Quantity, found: Standings, entries: Mapping[str, Entry]) -> Section:
    total = found[ALL, ALL]
    parts: list[str | Table | Picture] = [
        _table(quantity, total, entries),
        Picture(
            f"standings_{quantity.name}",
            _drawn(quantity, total),
            f"{quantity.title}: median error of all visible images, and coverage of the stated "
            "standard deviations, each with its 95 % interval.",
            "leaderboard.csv",
        ),
    ]
    return Section(quantity.title, *parts)


def _table(quantity: _Quantity, total: list[Standing], entries: Mapping[str, Entry]) -> Table:
    caption = (
        f"{quantity.title} ({quantity.unit}), on {total[0].visible} visible images; missed and "
        "within are in %, false spots per 100 images. σ as the entry states it; ideal are "
        f"{100 * _ONE:.1f} and {100 * _WIDE:.1f} %. The bound is that of Cramér and Rao for each "
        "image, for an estimator that knows the wall and the shape of the light. Times are as the "
        "entries state them, or wall times of this run."
    )
    return Table.of_rows(_Shown, _shown(quantity, total, entries), caption, data="leaderboard.csv")


def _shown(
    quantity: _Quantity, total: list[Standing], entries: Mapping[str, Entry]
) -> list[_Shown]:
    digits = quantity.digits
    return [
        _Shown(
            _rank(standing.rank),
            standing.entry,
            _interval(standing.median, digits),
            _interval(standing.ninth, digits),
            _interval(standing.rmse, digits),
            _interval(standing.missed, 1, scale=100),
            _interval(standing.false_spots, 1, scale=100),
            _interval(standing.within_1, 1, scale=100),
            _interval(standing.within_196, 1, scale=100),
            _interval(standing.over_bound, 1),
            _milliseconds(entries[standing.entry]),
            entries[standing.entry].command,
            entries[standing.entry].versions,
            entries[standing.entry].seed,
        )
        for standing in total
    ]


def _by_condition(quantity: _Quantity, found: Standings) -> Section:
    names = [standing.entry for standing in found[ALL, ALL]]
    rows = []
    for (condition, group), placed in found.items():
        by_name = {standing.entry: standing for standing in placed}
        cells = [_place(by_name[name], quantity.digits) for name in names]
        rows.append((_TITLES.get(condition, "all"), group, placed[0].visible, *cells))
    columns = [Column(text) for text in ("condition", "group", "visible", *names)]
    caption = f"Rank, and in brackets the median error ({quantity.unit}), by condition."
    table = Table(columns, rows, caption, "leaderboard_by_condition.csv")
    return Section(f"{quantity.title}: ranks by condition", table)


def _made(entries: Mapping[str, Entry]) -> Table:
    rows = [
        _Made(entry.name, entry.command, entry.versions, entry.seed) for entry in entries.values()
    ]
    return Table.of_rows(
        _Made, rows, "As the entries state it in entry.json.", data="leaderboard.csv"
    )


def _rows(
    quantity: str, found: Standings, entries: Mapping[str, Entry]
) -> Iterator[LeaderboardRow]:
    for (condition, group), placed in found.items():
        for standing in placed:
            entry = entries[standing.entry]
            yield LeaderboardRow(
                quantity,
                condition,
                group,
                round(standing.rank.value),
                *standing.rank[1:],
                entry.name,
                standing.visible,
                *standing.missed,
                standing.false_spots.value,
                *standing.median,
                *standing.ninth,
                *standing.rmse,
                *standing.within_1,
                *standing.within_196,
                *standing.over_bound,
                math.nan if entry.ms_per_frame is None else entry.ms_per_frame,
                entry.command,
                entry.versions,
                entry.seed,
            )


def _drawn(quantity: _Quantity, total: list[Standing]) -> Drawing:
    figure = Drawing(figsize=(_WIDTH_IN, _FRAME_IN + _LINE_IN * len(total)), layout="constrained")
    left, right = figure.subplots(1, 2, sharey=True)
    places = np.arange(len(total))
    _points(left, places, [standing.median for standing in total], BLUE, "median")
    if any(standing.median.value > 0 for standing in total):
        left.set_xscale("log")
    left.set(xlabel=f"median |e| ({quantity.unit})")
    left.set_yticks(places, [in_figure(standing.entry) for standing in total])
    left.set_ylim(len(total) - 0.5, -0.5)
    for part, ideal, colour, label in (
        ("within_1", _ONE, BLUE, "within 1 σ"),
        ("within_196", _WIDE, VERMILION, "within 1.96 σ"),
    ):
        right.axvline(100 * ideal, color=GREY, ls="--", lw=0.8)
        figures = [
            Figure(*(100 * value for value in getattr(standing, part))) for standing in total
        ]
        _points(right, places, figures, colour, label)
    right.set(xlabel="errors within the stated σ (%)", xlim=(0, 102))
    right.legend(loc="best")
    return figure


def _points(axes: Axes, places: np.ndarray, figures: list[Figure], colour: str, label: str) -> None:
    shown = [(place, own) for place, own in zip(places, figures, strict=True)]
    shown = [(place, own) for place, own in shown if math.isfinite(own.value)]
    axes.plot(
        [own.value for _, own in shown], [p for p, _ in shown], "o", color=colour, label=label
    )
    for place, own in shown:
        if math.isfinite(own.low) and math.isfinite(own.high):
            axes.hlines(place, own.low, own.high, color=colour)


def _interval(figure: Figure, digits: int, *, scale: float = 1.0) -> str:
    """A figure with its interval, such as "0.021 [0.019, 0.024]"."""
    value, low, high = (_number(part * scale, digits) for part in figure)
    return value if math.isnan(figure.low) else f"{value} [{low}, {high}]"


def _number(value: float, digits: int) -> str:
    if math.isnan(value):
        return "–"
    return "∞" if math.isinf(value) else f"{value:.{digits}f}"


def _rank(rank: Figure) -> str:
    value, low, high = (f"{part:.0f}" for part in rank)
    return value if math.isnan(rank.low) or low == high else f"{value} [{low}–{high}]"


def _place(standing: Standing, digits: int) -> str:
    if math.isnan(standing.median.value):
        return "–"
    return f"{standing.rank.value:.0f} ({_number(standing.median.value, digits)})"


def _milliseconds(entry: Entry) -> str:
    return "–" if entry.ms_per_frame is None else f"{entry.ms_per_frame:.1f}"
