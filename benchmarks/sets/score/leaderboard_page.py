"""The page of `eyespot score`: standings on the images, and how each entry was made."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from eyespot.benchmarks import reporting as page
from eyespot.benchmarks.paper import ELLIPSE
from eyespot.benchmarks.reporting import rows_of, where
from eyespot.benchmarks.sets.read import SetStack
from eyespot.benchmarks.sets.score import judging
from eyespot.benchmarks.sets.score.judging import ALL, MAIN, Against, Score
from eyespot.benchmarks.sets.score.scored_spots import ScoredEstimator
from eyespot.formats.report_page import in_figure

_WITHIN_1_SIGMA, _WITHIN_196_SIGMA = 0.683, 0.950  # Parts of normal errors.

_RULE = (
    "Entries are ranked by the median of the absolute error over all images in which half of the "
    "contour or more is visible. A missed image counts as an infinite error. Intervals contain "
    "95 % of 1,000 bootstrap samples of whole stacks, the same for all entries. A rank's interval "
    "shows which entries the set can distinguish."
)

_QUANTITIES = {
    "semi_minor_px": ("Semi-minor axis e₁′", "px", ".3f"),
    "centre_px": ("Centre", "px", ".3f"),
    "distance_mm": ("Distance d", "mm", ".4f"),
}
"""Title, unit and format of the ranked quantities."""

_SHOWN = {
    "rank": page.Column("rank"),
    "entry": page.Column("entry"),
    "median": page.Column("median |e|"),
    "ninth_decile": page.Column("90 % of |e|"),
    "rmse": page.Column("RMSE if found"),
    "missed": page.Column("missed"),
    "false_spots": page.Column("false spots"),
    "within_1_sigma": page.Column("within 1 σ"),
    "within_196_sigma": page.Column("within 1.96 σ"),
    "over_bound": page.Column("error / bound"),
    "ms_per_frame": page.Column("ms per frame"),
}


def leaderboard(
    result: Score,
    entries: Sequence[ScoredEstimator],
    *,
    name: str,
    stacks: Sequence[SetStack] = (),
) -> page.Report:
    """The report of a leaderboard; InputError if the entries cover no image together.

    Args:
        stacks: of the scored images, for a picture of the best entry's worst ones.
    """
    made = pd.DataFrame([vars(entry) for entry in entries]).drop(columns="spots")
    made = made.rename(columns={"name": "entry"}).astype({"ms_per_frame": float})
    first: list[page.Picture | page.Table] = []
    claims, sections, ranks = [], [], []
    data: dict[str, pd.DataFrame | None] = {}
    for quantity, (title, unit, form) in _QUANTITIES.items():
        ranked = judging.standings(result.judged, quantity)
        if ranked.empty:
            continue
        ranked = ranked.merge(made, on="entry")
        total = ranked[ranked.condition == ALL]
        shown = _shown(total, form)
        best, text = total.iloc[0], shown["median"].iloc[0]
        claims.append(
            page.Claim(
                name=title,
                sentence=(
                    f"{best.entry} has a median error of {text} {unit}."
                    if len(total) == 1
                    else f"{best.entry} has the least median error: {text} {unit}."
                )
                + f" It misses {100 * best.missed:.1f} % of {best.visible} visible spots.",
                value=best["median"],
            )
        )
        picture = page.Picture(
            f"standings_{quantity}",
            _drawn(total, unit),
            f"{title}: median error of all visible images and, of entries that state standard "
            "deviations, their coverage, each with its 95 % interval.",
            "leaderboard.csv",
        )
        table = page.Table(
            shown,
            _SHOWN,
            f"{title} ({unit}), on {best.visible} visible images; missed and within are in %, "
            "false spots per 100 images. σ as the entry states it; ideal are "
            f"{100 * _WITHIN_1_SIGMA:.1f} and {100 * _WITHIN_196_SIGMA:.1f} %. The bound is that "
            "of Cramér and Rao for each image, for an estimator that knows the wall and the shape "
            "of the light. Times are as the entries state them, or wall times of this run.",
            data="leaderboard.csv",
        )
        parts: list[page.Table | page.Picture] = [table, *([picture] if first else [])]
        if quantity == MAIN and stacks:
            parts += _worst(where(result.judged, estimator=best.entry), result.against, stacks)
        sections.append(page.Section(title, *parts))
        if not first:
            columns = {key: _SHOWN[key] for key in ("rank", "entry", "median", "missed")}
            caption = f"{title} ({unit}), with 95 % intervals; missed in %."
            first = [picture, page.Table(shown, columns, caption, data="standings.csv")]
            data["standings.csv"] = shown
        ranked.insert(0, "quantity", quantity)
        ranks.append(ranked.drop(columns=["false_spots_low", "false_spots_high"]))
    if ranks:
        every = pd.concat(ranks, ignore_index=True)
        data["leaderboard.csv"] = every[every.condition == ALL]
        data["leaderboard_by_condition.csv"] = every
    about = {key: page.Column(key) for key in ("entry", "command", "versions", "seed")}
    stated = (made[["command", "versions", "seed"]] != "").any(axis=None)
    how = page.Table(made, about, "As the entries state it in entry.json.", data="leaderboard.csv")
    return page.Report(
        title=f"Leaderboard of {name}",
        answer=claims[0].text if claims else "",
        lead=f"Compared with the true ellipse {result.against}. {_RULE}",
        first=first,
        claims=claims,
        sections=[
            *sections,
            *([page.Section("How the entries were made", how)] if stated else []),
        ],
        data=data | {"score.csv": None},
    )


_MOST_WORST = 6
_HALF_CUT_OUT = 1.6  # In semi-major axes.


def _worst(
    judged: pd.DataFrame, against: Against, stacks: Sequence[SetStack]
) -> list[page.Picture]:
    """The images of one entry with the largest errors of the main quantity; none without one."""
    errors = judged[f"error_{MAIN}"].abs().dropna()
    worst = rows_of(judged.loc[errors.nlargest(_MOST_WORST).index])
    if not worst:
        return []
    by_name = {entry.qualified_name: entry for entry in stacks}

    def draw(axes: Axes, _: str, row: Any) -> None:
        true, off = (
            np.array([getattr(row, f"{kind}_{name}") for name in ELLIPSE])
            for kind in (against, "error")
        )
        # The angle of a spot that is nearly round is not scored.
        measured, image = true + np.nan_to_num(off), by_name[row.stack].open().image(row)
        bits = max(int(image.max()).bit_length(), 8)
        looks = {"color": "white", "lw": 2.5}, {"color": page.BLUE, "lw": 1.0}
        page.draw_spots(axes, image, bits, *zip((true, measured), looks, strict=True))
        (x, y), half = true[:2], _HALF_CUT_OUT * true[2]
        axes.set(xlim=(x - half, x + half), ylim=(y + half, y - half))

    def title(_: str, row: Any) -> str:
        return in_figure(f"{row.stack}\n{getattr(row, f'error_{MAIN}'):+.2f} px")

    figure = page.small_multiples(draw, columns=worst, title=title, height=2.2, legend_columns=0)
    entry = judged.estimator.iloc[0]
    caption = (
        f"The worst images of {entry}: largest errors of e₁′ among the spots that it found. Blue: "
        "the measured ellipse. White: the true one."
    )
    return [page.Picture("worst", figure, caption, "score.csv", inline="jpeg")]


def _shown(total: pd.DataFrame, form: str) -> pd.DataFrame:
    """Content of standings.csv and, without the last three columns, of the page's table."""
    sizes = dict.fromkeys(("median", "ninth_decile", "rmse"), form) | {"over_bound": ".1f"}
    texts = {name: with_intervals(total, name, own, none="–") for name, own in sizes.items()}
    for name in ("missed", "false_spots", "within_1_sigma", "within_196_sigma"):
        texts[name] = with_intervals(total, name, ".1f", scale=100.0, none="–")
    ranks = [
        f"{rank:.0f}" + ("" if math.isnan(low) or low == high else f" [{low:.0f}–{high:.0f}]")
        for rank, low, high in zip(total["rank"], total.rank_low, total.rank_high, strict=True)
    ]
    times = [number_text(ms, ".1f") for ms in total.ms_per_frame]
    found = total.assign(**texts, rank=ranks, ms_per_frame=times)
    return found[[*_SHOWN, "command", "versions", "seed"]]


def _drawn(total: pd.DataFrame, unit: str) -> Figure:
    """Median error of each entry and, if any states its errors, their coverage."""
    figure = Figure(figsize=(9.0, 1.1 + 0.32 * len(total)), layout="constrained")
    stated = total.within_196_sigma.notna().any()
    left, *others = figure.subplots(1, 2 if stated else 1, sharey=True, squeeze=False)[0]
    places = np.arange(len(total))

    def points(axes: Axes, name: str, colour: str, label: str, scale: float = 1.0) -> None:
        ends = name.removesuffix("_sigma")
        sizes = scale * total[[name, f"{ends}_low", f"{ends}_high"]]
        middle, low, high = sizes.replace(math.inf, math.nan).to_numpy(float).T
        axes.plot(middle, places, "o", color=colour, label=label)
        axes.hlines(places, low, high, color=colour)

    points(left, "median", page.BLUE, "median")
    if (total["median"] > 0).any():
        left.set_xscale("log")
    left.set(xlabel=f"median |e| ({unit})", ylim=(len(total) - 0.5, -0.5))
    left.set_yticks(places, [in_figure(name) for name in total.entry])
    for right in others:
        for name, ideal, colour, label in (
            ("within_1_sigma", _WITHIN_1_SIGMA, page.BLUE, "within 1 σ"),
            ("within_196_sigma", _WITHIN_196_SIGMA, page.VERMILION, "within 1.96 σ"),
        ):
            right.axvline(100 * ideal, color=page.GREY, ls="--", lw=0.8)
            points(right, name, colour, label, scale=100.0)
        right.set(xlabel="errors within the stated σ (%)", xlim=(0, 102))
        right.legend(loc="best")
    return figure


def number_text(value: float, form: str, *, none: str = "–") -> str:
    """A figure, such as "0.021"; `none` if it is unknown."""
    return none if math.isnan(value) else "∞" if math.isinf(value) else format(value, form)


def with_intervals(
    rows: pd.DataFrame, name: str, form: str, *, scale: float = 1.0, none: str = ""
) -> list[str]:
    """Figures with their intervals, such as "0.021 [0.019, 0.024]"."""
    ends = name.removesuffix("_sigma")
    columns = (scale * rows[key] for key in (name, f"{ends}_low", f"{ends}_high"))
    texts = zip(
        *([number_text(x, form, none=none) for x in column] for column in columns), strict=True
    )
    return [
        value if low == none or low == high == value else f"{value} [{low}, {high}]"
        for value, low, high in texts
    ]
