"""The whole run: reads or measures spots, scores them, prints and writes tables."""

from __future__ import annotations

import math
import shlex
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from itertools import chain
from pathlib import Path
from typing import Any, Literal, NamedTuple

import matplotlib
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter, StrMethodFormatter

from benchmarks.paper import VISIBLE_ENOUGH
from benchmarks.reporting import (
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    PURPLE,
    SKY,
    STYLE,
    VERMILION,
    Claim,
    Column,
    Picture,
    Report,
    Section,
    Table,
    grouped,
    write_page,
)
from benchmarks.sets.read import Mode, stacks_of
from benchmarks.sets.score.judging import (
    ALL,
    CONDITIONS,
    MAIN,
    Against,
    Outcome,
    Score,
    images_of,
    score,
    standings,
    z_scores,
)
from benchmarks.sets.score.spots import (
    Entry,
    entries_in,
    entry_of,
    read_set_spots,
    sample_folder,
    track_set,
)
from benchmarks.study import versions, write_json
from estimator import Calibration, SpotRecord, read_calibration, write_spots
from estimator.files import (
    fingerprint,
    in_figure,
    in_utf8,
    require_space,
    written_whole,
)
from estimator.run import progress, say
from optics import InputError

# Views of a score: tables on the terminal, and the figure of errors and misses by condition.

# Tables on the terminal, as wide as they need to be.

_MOST_ESTIMATORS = 4  # with two columns each


def tables(result: Score) -> dict[str, pd.DataFrame]:
    """Outcomes and errors of all images, calibration of σ, and the main quantity by condition.

    By title. The last table is left out if there are too many estimators; the page has it.
    """
    images = result.counts[result.counts.condition == ALL]
    images = images.drop(columns=["condition", "group"]).assign(
        left_out=images.estimator.map(result.left_out),
        why_missed=images.estimator.map({name: _reasons(of) for name, of in result.judged.items()}),
    )
    images = images.rename(columns={"visible": "spot visible", "glimpsed": "reported if hidden"})
    order = {name: place for place, name in enumerate(result.judged)}
    errors = result.errors[result.errors.condition == ALL]
    errors = errors.sort_values("estimator", kind="stable", key=lambda names: names.map(order))
    sizes = errors[["estimator", "quantity", "n"]].assign(
        bias=_texts(errors.bias, "{:+.3f}"),
        RMSE=_with_interval(errors, "rmse", 3),
        median=_texts(errors.median_abs, "{:.3f}"),
        largest=_texts(errors.max_abs, "{:.3f}"),
    )
    stated = errors[errors.n_sigma > 1]
    sigmas = stated[["estimator", "quantity"]].assign(
        n=stated.n_sigma,
        mean=_texts(stated.z_mean, "{:+.2f}"),
        spread=_texts(stated.z_std, "{:.2f}"),
        within_σ=_with_interval(stated, "within_1_sigma", 2),
        within_2σ=_with_interval(stated, "within_2_sigma", 2),
    )
    found = {
        "Images": images,
        f"Errors of the found spots ({result.against}), with 95 % intervals in brackets": sizes,
        "Errors divided by the estimator's σ; ideal: 0 ± 1, 0.68, 0.95": sigmas,
    }
    if len(result.judged) <= _MOST_ESTIMATORS:
        here = result.by_condition
        missed = here.missed.astype(str) + " of " + here.visible.astype(str)
        rows = here[["condition", "group"]].assign(estimator=here.estimator, missed=missed)
        rows["RMSE"] = _with_interval(here, "rmse", 3)
        found[f"RMSE of {MAIN}, and missed images"] = rows
    return {title: frame for title, frame in found.items() if len(frame)}


def _reasons(judged: pd.DataFrame) -> str:
    counts = judged.reason[judged.outcome == Outcome.MISSED].value_counts()
    return ", ".join(f"{count} {str(why).replace('_', ' ')}" for why, count in counts.items())


def _texts(values: pd.Series, form: str) -> list[str]:
    return ["" if math.isnan(value) else form.format(value) for value in values]


def _with_interval(rows: pd.DataFrame, name: str, digits: int) -> list[str]:
    """Figures with their intervals, such as "0.021 [0.019, 0.024]"."""
    ends, form = name.removesuffix("_sigma"), f"{{:.{digits}f}}"
    low, high = (_texts(rows[f"{ends}_{end}"], form) for end in ("low", "high"))
    values = zip(_texts(rows[name], form), low, high, strict=True)
    return [f"{value} [{low}, {high}]" if low else value for value, low, high in values]


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


# The leaderboard as a page: standings, ranks by condition, and how each entry was made.

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
        answer=next((_best(quantity, total).text for quantity, total in totals.items()), ""),
        lead=f"{len(entries)} entries, compared with the true ellipse {result.against}. {_RULE}",
        first=[
            part
            for quantity, total in [*totals.items()][:1]
            for part in (
                _standings_picture(quantity, total),
                Table.of(
                    shown[quantity],
                    {key: _SHOWN[key] for key in ("rank", "entry", "median", "missed")},
                    f"{quantity.title} ({quantity.unit}), with 95 % intervals; missed in %.",
                    data="standings.csv",
                ),
            )
        ],
        claims=[_best(quantity, total) for quantity, total in totals.items()],
        sections=[
            *(
                _section(quantity, total, shown[quantity], first=number == 0)
                for number, (quantity, total) in enumerate(totals.items())
            ),
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


def _standings_picture(quantity: _Quantity, total: pd.DataFrame) -> Picture:
    return Picture(
        f"standings_{quantity.name}",
        _drawn(quantity, total),
        f"{quantity.title}: median error of all visible images, and coverage of the stated "
        "standard deviations, each with its 95 % interval.",
        "leaderboard.csv",
    )


def _section(
    quantity: _Quantity, total: pd.DataFrame, shown: pd.DataFrame, *, first: bool
) -> Section:
    """The quantity's standings; the picture of the first one stands at the top of the page."""
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
        *([] if first else [_standings_picture(quantity, total)]),
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
    exact = math.isnan(row[f"{ends}_low"]) or low == high == value
    return value if exact else f"{value} [{low}, {high}]"


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


_SCHEMA = 1
_LEAST_BYTES = 2**18  # of the figures
_TRACKING = ("eyespot", "opencv-python-headless", "numpy")  # what the measured spots depend on


def run(
    folder: Path,
    spots_files: Sequence[Path],
    *,
    entries: Path | None = None,
    mode: Mode | Literal["both"] | None = None,
    calibration: Path | None = None,
    unrelated: bool = False,
    against: Against = "half_max",
    split: str | None = None,
    out: Path | None = None,
) -> Score:
    """Score spots files, entries of a leaderboard and modes of our estimator on a set.

    Args:
        folder: a set or a stack.
        spots_files: see `read_set_spots`; the name of a file is the name of the estimator.
        entries: folder with entries, see `entries_in`.
        mode: mode of our estimator that measures the images first; "both" are the literal and the
            sub-pixel mode.
        calibration: of the beam, for the mode pixels; None for each stack's true one.
        unrelated: let our estimator measure every image by itself.
        against: which of the two ellipses is the truth.
        split: the only split to score; None: all splits.
        out: new folder for report.html with leaderboard.csv and leaderboard_by_condition.csv,
            score.json, score.csv, figures, and MODE.csv with the measured spots; None: only return
            the score.

    Raises:
        InputError: the input is invalid, or `out` exists.
        OSError: `out` cannot be written.
    """
    folder = Path(folder)
    modes: tuple[Mode, ...] = ("literal", "subpixel")
    modes = modes if mode == "both" else (mode,) if mode else ()
    given = [entry_of(path) for path in spots_files] + (entries_in(entries) if entries else [])
    _check([*(entry.name for entry in given), *modes])
    if calibration is not None and mode != "pixels":
        raise InputError("calibration has no effect without --mode pixels. Give both, or neither.")
    beam = None if calibration is None else read_calibration(calibration)
    if out is None:
        return _scored(folder, given, modes, beam, unrelated, against, split)[0]
    with written_whole(out) as whole:
        whole.mkdir()
        require_space(out, _LEAST_BYTES)
        result, measured, found = _scored(folder, given, modes, beam, unrelated, against, split)
        write_json(whole / "score.json", _summary(result, folder))
        result.table.to_csv(whole / "score.csv", index=False, lineterminator="\n")
        for name, records in measured.items():
            write_spots(whole / f"{name}.csv", records)
        words = ["eyespot", "score", folder, *spots_files]
        options = {"entries": entries, "mode": mode, "calibration": calibration, "split": split}
        options |= {"out": out}
        words += ["--unrelated"] * unrelated
        given_options = [[f"--{name}", value] for name, value in options.items() if value]
        words += [*chain(*given_options), "--against", against]
        with matplotlib.rc_context(STYLE):
            write_page(
                whole,
                leaderboard(result, found, name=in_utf8(folder.resolve().name)),
                command=shlex.join(map(str, words)),
                versions=versions(),
                summary_file="score.json",
            )
    say(f"Wrote {out / 'report.html'}.", result=True)
    return result


def _scored(
    folder: Path,
    given: Sequence[Entry],
    modes: Sequence[Mode],
    beam: Calibration | None,
    unrelated: bool,
    against: Against,
    split: str | None,
) -> tuple[Score, dict[str, list[SpotRecord]], dict[str, Entry]]:
    """Measure and score; returns also the measured spots by mode, and all entries."""
    stacks = stacks_of(folder)
    chosen = [entry for entry in stacks if split in (None, entry.split)]
    if not chosen:
        known = ", ".join(dict.fromkeys(entry.split for entry in stacks if entry.split))
        raise InputError(f"the set has no split {split}. It has: {known or 'no splits'}.")
    images = images_of(stacks)
    spots = {
        entry.name: read_set_spots(entry.spots, stacks, images.index)
        for entry in given
        if entry.spots
    }
    measured: dict[str, list[SpotRecord]] = {}
    found = {entry.name: entry for entry in given}
    scored = images if split is None else images[images.split == split]
    with progress("Tracking", total=len(scored) * len(modes)) as advance:
        for mode in modes:
            begin = time.perf_counter()
            measured[mode] = track_set(
                *(chosen, mode), calibration=beam, unrelated=unrelated, progress=advance
            )
            passed = time.perf_counter() - begin
            spots[mode] = {record.file_name: record for record in measured[mode]}
            found[mode] = _own_entry(mode, folder, 1000 * passed / len(scored))
    kept = {
        name: {image: record for image, record in records.items() if image in scored.index}
        for name, records in spots.items()
    }
    if empty := [name for name, records in kept.items() if not records]:
        raise InputError(f"{empty[0]} has no spots of the split {split}. Give another --split.")
    result = score(scored, kept, against=against)
    return result, measured, found


def _own_entry(mode: Mode, folder: Path, ms_per_frame: float) -> Entry:
    """The entry of a mode of our estimator; the time includes the reading of the images."""
    return Entry(
        name=mode,
        command=f"eyespot score {_named(folder)} --mode {mode}",
        versions=", ".join(f"{name} {versions()[name]}" for name in _TRACKING),
        ms_per_frame=ms_per_frame,
    )


def _named(folder: Path) -> str:
    """How a command names a set; the path on this machine means nothing to others."""
    is_sample = folder.resolve() == sample_folder().resolve()
    return "--sample" if is_sample else in_utf8(folder.resolve().name)


def _check(names: Sequence[str]) -> None:
    if not names:
        raise InputError(
            "nothing to score. Give spots files, --entries, or --mode to measure the images."
        )
    if twice := [name for name, count in Counter(names).items() if count > 1]:
        raise InputError(f"two estimators have the name {twice[0]}. Rename one of the spots files.")


def _summary(result: Score, folder: Path) -> dict[str, object]:
    """Content of score.json."""
    manifest = folder / "manifest.json"
    keys = ["estimator", "condition", "group"]
    errors = {
        key: of.drop(columns=keys).to_dict("records") for key, of in result.errors.groupby(keys)
    }
    return {
        "schema": _SCHEMA,
        "set": folder.resolve().name,
        "manifest": fingerprint(manifest) if manifest.is_file() else None,
        "against": result.against,
        "visible_from_fraction": VISIBLE_ENOUGH,
        "outcomes": {name: Counter(judged.outcome) for name, judged in result.judged.items()},
        "reasons_of_misses": {
            name: Counter(judged.reason[judged.outcome == Outcome.MISSED])
            for name, judged in result.judged.items()
        },
        "left_out": result.left_out,
        "groups": [
            {**counts, "errors": errors.get(tuple(counts[key] for key in keys), [])}
            for counts in result.counts.to_dict("records")
        ],
        "versions": versions(),
    }
