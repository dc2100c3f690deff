"""`eyespot score`: its tables on the terminal, its page, and the files that it writes."""

import math
import shlex
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import nullcontext
from itertools import chain
from pathlib import Path
from typing import Annotated, Any, Literal

import matplotlib
import numpy as np
import pandas as pd
from cyclopts import Parameter
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from eyespot.benchmarks import reporting as page
from eyespot.benchmarks.paper import ELLIPSE, VISIBLE_ENOUGH
from eyespot.benchmarks.reporting import grouped, rows_of, where
from eyespot.benchmarks.sets.read import Mode, SetStack, check_unchanged, stacks_of
from eyespot.benchmarks.sets.score import judging
from eyespot.benchmarks.sets.score import spots as spots_of_set
from eyespot.benchmarks.sets.score.judging import ALL, MAIN, Against, Outcome, Score
from eyespot.benchmarks.sets.score.spots import ScoredEstimator, sample_folder
from eyespot.benchmarks.study import versions, write_json
from eyespot.estimator.run.options import OUT
from eyespot.estimator.run.progress_bar import progress, say
from eyespot.formats.calibration import read_calibration
from eyespot.formats.inputs import InputError, in_utf8
from eyespot.formats.manifest import fingerprint
from eyespot.formats.page import in_figure
from eyespot.formats.spots import SpotRecord, write_spots
from eyespot.formats.whole_files import require_space, written_whole

# Tables on the terminal, as wide as they need to be.

_MOST_ESTIMATORS = 4  # More would make the last table too wide.


def tables(result: Score) -> dict[str, pd.DataFrame]:
    """Outcomes and errors of all images, calibration of σ, and the main quantity by condition.

    By title. The last table is left out if there are too many estimators; the page has it.
    """
    images = result.counts[result.counts.condition == ALL]
    why = dict.fromkeys(result.left_out, "")
    for name, counts in reasons_of_misses(result).items():
        said = (f"{n} {str(reason).replace('_', ' ')}" for reason, n in counts.items())
        why[name] = ", ".join(said)
    images = images.drop(columns=["condition", "group"]).assign(
        left_out=images.estimator.map(result.left_out),
        why_missed=images.estimator.map(why),
    )
    images = images.rename(columns={"visible": "spot visible", "glimpsed": "reported if hidden"})
    errors = result.errors[result.errors.condition == ALL]
    sizes = errors[["estimator", "quantity", "n"]].assign(
        bias=[_number(value, "+.3f", none="") for value in errors.bias],
        RMSE=_with_intervals(errors, "rmse", ".3f"),
        median=[_number(value, ".3f") for value in errors.median_abs],
        largest=[_number(value, ".3f") for value in errors.max_abs],
    )
    stated = errors[errors.n_sigma > 1]
    sigmas = stated[["estimator", "quantity"]].assign(
        n=stated.n_sigma,
        mean=[_number(value, "+.2f") for value in stated.z_mean],
        spread=[_number(value, ".2f") for value in stated.z_std],
        within_σ=_with_intervals(stated, "within_1_sigma", ".2f"),
        within_2σ=_with_intervals(stated, "within_2_sigma", ".2f"),
    )
    found = {
        "Images": images,
        f"Errors of the found spots ({result.against}), with 95 % intervals in brackets": sizes,
        "Errors divided by the estimator's σ; ideal: 0 ± 1, 0.68, 0.95": sigmas,
    }
    if len(images) <= _MOST_ESTIMATORS:
        here = result.by_condition
        missed = here.missed.astype(str) + " of " + here.visible.astype(str)
        rows = here[["condition", "group"]].assign(estimator=here.estimator, missed=missed)
        rows["RMSE"] = _with_intervals(here, "rmse", ".3f")
        found[f"RMSE of {MAIN}, and missed images"] = rows
    return {title: frame for title, frame in found.items() if len(frame)}


def reasons_of_misses(result: Score) -> dict[str, dict[str, int]]:
    """How many visible spots each estimator missed, by its reason, the most frequent first."""
    missed = where(result.judged, outcome=Outcome.MISSED)
    reasons = {str(name): of.reason for name, of in grouped(missed, "estimator")}
    return {name: dict(Counter(own).most_common()) for name, own in reasons.items()}


def _number(value: float, form: str, *, none: str = "–") -> str:
    return none if math.isnan(value) else "∞" if math.isinf(value) else format(value, form)


def _with_intervals(
    rows: pd.DataFrame, name: str, form: str, *, scale: float = 1.0, none: str = ""
) -> list[str]:
    """Figures with their intervals, such as "0.021 [0.019, 0.024]"."""
    ends = name.removesuffix("_sigma")
    columns = (scale * rows[key] for key in (name, f"{ends}_low", f"{ends}_high"))
    texts = zip(*([_number(x, form, none=none) for x in column] for column in columns), strict=True)
    return [
        value if low == none or low == high == value else f"{value} [{low}, {high}]"
        for value, low, high in texts
    ]


# The leaderboard as a page: standings, and how each entry was made.

_ONE, _WIDE = 0.683, 0.950  # parts of normal errors within 1 and 1.96 sigma

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
    entries: Mapping[str, ScoredEstimator],
    *,
    name: str,
    stacks: Sequence[SetStack] = (),
) -> page.Report:
    """The report of a leaderboard; InputError if the entries cover no image together.

    Args:
        stacks: of the scored images, for a picture of the best entry's worst ones.
    """
    made = pd.DataFrame([vars(entry) for entry in entries.values()]).drop(columns="spots")
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
            f"{100 * _ONE:.1f} and {100 * _WIDE:.1f} %. The bound is that of Cramér and Rao for "
            "each image, for an estimator that knows the wall and the shape of the light. Times "
            "are as the entries state them, or wall times of this run.",
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
_AROUND = 1.6  # half of the side of a cut-out, in semi-major axes


def _worst(
    judged: pd.DataFrame, against: Against, stacks: Sequence[SetStack]
) -> list[page.Picture]:
    """The images of one entry with the largest errors of the main quantity; none without one."""
    errors = judged[f"error_{MAIN}"].abs().dropna()
    worst = judged.loc[errors.nlargest(_MOST_WORST).index]
    by_name = {entry.qualified_name: entry for entry in stacks}
    shown = []
    for row in rows_of(worst):
        true = [getattr(row, f"{against}_{name}") for name in ELLIPSE]
        off = [getattr(row, f"error_{name}") for name in ELLIPSE]
        # The angle of a spot that is nearly round is not scored.
        measured = [t + (0.0 if math.isnan(e) else e) for t, e in zip(true, off, strict=True)]
        image = by_name[row.stack].open().image(row)
        caption = f"{row.stack}\n{getattr(row, f'error_{MAIN}'):+.2f} px"
        half = round(_AROUND * true[2])
        shown.append(page.CutOut(image, half, true, measured, in_figure(caption)))
    if not shown:
        return []
    entry = judged.estimator.iloc[0]
    caption = (
        f"The worst images of {entry}: largest errors of e₁′ among the spots that it found. Blue: "
        "the measured ellipse. White: the true one."
    )
    return [page.Picture("worst", page.cut_outs(shown), caption, "score.csv", inline="jpeg")]


def _shown(total: pd.DataFrame, form: str) -> pd.DataFrame:
    """Content of standings.csv and, without the last three columns, of the page's table."""
    sizes = dict.fromkeys(("median", "ninth_decile", "rmse"), form) | {"over_bound": ".1f"}
    texts = {name: _with_intervals(total, name, own, none="–") for name, own in sizes.items()}
    for name in ("missed", "false_spots", "within_1_sigma", "within_196_sigma"):
        texts[name] = _with_intervals(total, name, ".1f", scale=100.0, none="–")
    ranks = [
        f"{rank:.0f}" + ("" if math.isnan(low) or low == high else f" [{low:.0f}–{high:.0f}]")
        for rank, low, high in zip(total["rank"], total.rank_low, total.rank_high, strict=True)
    ]
    times = [_number(ms, ".1f") for ms in total.ms_per_frame]
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
            ("within_1_sigma", _ONE, page.BLUE, "within 1 σ"),
            ("within_196_sigma", _WIDE, page.VERMILION, "within 1.96 σ"),
        ):
            right.axvline(100 * ideal, color=page.GREY, ls="--", lw=0.8)
            points(right, name, colour, label, scale=100.0)
        right.set(xlabel="errors within the stated σ (%)", xlim=(0, 102))
        right.legend(loc="best")
    return figure


_SCHEMA = 2
_LEAST_BYTES = 2**18  # The figures need about as much.
_TRACKING = ("eyespot", "opencv-python-headless", "numpy")  # what the measured spots depend on


def run(
    folder: Path,
    spots_files: Sequence[Path],
    *,
    entries: Path | None = None,
    mode: Mode | Literal["both"] | None = None,
    calibration: Path | None = None,
    unrelated: bool | None = None,
    against: Against = "half_max",
    split: str | None = None,
    out: Path | None = None,
) -> Score:
    """Score spots files, entries of a leaderboard and modes of our estimator on a set.

    The arguments are those of `eyespot score`. The folder `out` gets report.html with
    leaderboard.csv and leaderboard_by_condition.csv, score.json, score.csv, figures, and MODE.csv
    with the measured spots; without it, nothing is written. Without anything to score the mode is
    auto.

    Raises:
        InputError: the input is invalid, or `out` exists.
        OSError: `out` cannot be written.
    """
    folder = Path(folder)
    if mode is None and not spots_files and entries is None:
        mode = "auto"
    modes: tuple[Mode, ...] = ("literal", "subpixel")
    modes = modes if mode == "both" else (mode,) if mode else ()
    given = [spots_of_set.entry_of(path) for path in spots_files]
    given += spots_of_set.entries_in(entries) if entries else []
    names = Counter([*(entry.name for entry in given), *modes])
    if twice := [name for name, count in names.items() if count > 1]:
        raise InputError(f"two estimators have the name {twice[0]}. Rename one of the spots files.")
    if calibration is not None and mode not in ("auto", "pixels"):
        raise InputError("calibration has no effect without --mode auto or pixels. Give both.")
    with nullcontext() if out is None else written_whole(out) as whole:
        if out is not None and whole is not None:
            whole.mkdir()
            require_space(out, _LEAST_BYTES)
        stacks = stacks_of(folder)
        check_unchanged(stacks)
        chosen = [entry for entry in stacks if split in (None, entry.split)]
        if not chosen:
            known = ", ".join(dict.fromkeys(entry.split for entry in stacks if entry.split))
            raise InputError(f"the set has no split {split}. It has: {known or 'no splits'}.")
        images = judging.images_of(stacks)
        scored = images if split is None else images[images.split == split]
        spots = {
            entry.name: spots_of_set.read_set_spots(entry.spots, stacks, images.index)
            for entry in given
            if entry.spots
        }
        found = {entry.name: entry for entry in given}
        with progress("Tracking", total=len(scored) * len(modes)) as advance:
            about: dict[str, Any] = {"unrelated": unrelated, "progress": advance}
            if calibration is not None:
                about["calibration"] = read_calibration(calibration)
            for own in modes:
                found[own], measured = measure(folder, chosen, own, **about)
                spots[own] = {record.file_name: record for record in measured}
                if whole is not None:
                    write_spots(whole / f"{own}.csv", measured)
        kept = {
            name: {image: record for image, record in records.items() if image in scored.index}
            for name, records in spots.items()
        }
        if empty := [name for name, records in kept.items() if not records]:
            raise InputError(f"{empty[0]} has no spots of the split {split}. Give another --split.")
        result = judging.score(scored, kept, against=against)
        if out is None or whole is None:
            return result
        words = ["eyespot", "score", folder, *spots_files]
        options = {"entries": entries, "mode": mode, "calibration": calibration, "split": split}
        options |= {"out": out}
        if unrelated is not None:
            words.append("--unrelated" if unrelated else "--sequence")
        given_options = [[f"--{name}", value] for name, value in options.items() if value]
        words += [*chain(*given_options), "--against", against]
        write(whole, result, found, chosen, folder=folder, command=shlex.join(map(str, words)))
    say(f"Wrote {out / 'report.html'}.", result=True)
    return result


def measure(
    folder: Path, stacks: Sequence[SetStack], mode: Mode, **options: Any
) -> tuple[ScoredEstimator, list[SpotRecord]]:
    """One of our modes as an entry, and its spots in the stacks; options of `track_set`."""
    begin = time.perf_counter()
    records = spots_of_set.track_set(stacks, mode, **options)
    passed = time.perf_counter() - begin
    # A path on this machine means nothing to others.
    is_sample = folder.resolve() == sample_folder().resolve()
    name = "--sample" if is_sample else in_utf8(folder.resolve().name)
    entry = ScoredEstimator(
        name=mode,
        command=f"eyespot score {name} --mode {mode}",
        versions=", ".join(f"{package} {versions()[package]}" for package in _TRACKING),
        ms_per_frame=1000 * passed / len(records),  # with the reading of the images
    )
    return entry, records


def write(
    out: Path,
    result: Score,
    entries: Mapping[str, ScoredEstimator],
    stacks: Sequence[SetStack],
    *,
    folder: Path,
    command: str,
) -> None:
    """Write the page of a score with its figures and tables, score.csv and score.json."""
    manifest = folder / "manifest.json"
    outcomes = grouped(result.judged, "estimator")
    summary = {
        "schema": _SCHEMA,
        "set": folder.resolve().name,
        "manifest": fingerprint(manifest) if manifest.is_file() else None,
        "against": result.against,
        "visible_from_fraction": VISIBLE_ENOUGH,
        "outcomes": {name: own.outcome.value_counts().to_dict() for name, own in outcomes},
        "reasons_of_misses": {n: {} for n in result.left_out} | reasons_of_misses(result),
        "left_out": result.left_out,
        "versions": versions(),
    }
    write_json(out / "score.json", summary)
    result.table.to_csv(out / "score.csv", index=False, lineterminator="\n")
    with matplotlib.rc_context(page.STYLE):
        page.write_page(
            out,
            leaderboard(result, entries, name=in_utf8(folder.resolve().name), stacks=stacks),
            command=command,
            versions=versions(),
            summary_file="score.json",
        )


# The command.


def score(
    folder: Path | None = None,
    spots: tuple[Path, ...] = (),
    /,
    *,
    entries: Path | None = None,
    mode: Literal["auto", "literal", "subpixel", "pixels", "both"] | None = None,
    calibration: Path | None = None,
    sample: bool = False,
    unrelated: Annotated[bool | None, Parameter(negative="--sequence")] = None,
    against: Literal["half_max", "cone"] = "half_max",
    split: str | None = None,
    out: Annotated[Path | None, OUT] = None,
    as_json: Annotated[bool, Parameter("--json")] = False,
) -> None:
    """Compare an estimator's spots with the labels of a set.

    Args:
        folder: Labelled set or stack; not needed with --sample.
        spots: Spots files with image names relative to the set, or folders with SPLIT/STACK.csv.
        entries: Folder of a leaderboard. Every spots file, and every folder with spots files, is an
            entry; see docs/leaderboard.md.
        mode: Also measure the images with our estimator, and score its spots; both: literal and
            subpixel; auto: as `eyespot track` (default: auto if no spots are given).
        calibration: The beam of the modes auto and pixels, from `eyespot fit` (default: each
            stack's true one).
        sample: Score on the small set that comes with eyespot.
        unrelated: Let --mode measure each image alone (default: if most true spots of a stack lie
            too far from the one before to be followed).
        against: True ellipse to compare with: the half-maximum contour, or the edge of the cone.
        split: Score only this split, such as test (default: all that have spots).
        out: Folder for the page report.html, tables and figures; it must not exist yet.
        as_json: Print the rows of score.csv as JSON.
    """
    if sample:
        # The first argument is then a spots file, too.
        spots, folder = (*([folder] if folder else []), *spots), sample_folder()
    if folder is None:
        raise InputError("FOLDER is missing: the set or stack to score on. Or give --sample.")
    result = run(
        folder,
        spots,
        entries=entries,
        mode=mode,
        calibration=calibration,
        unrelated=unrelated,
        against=against,
        split=split,
        out=out,
    )
    if as_json:
        print(result.table.to_json(orient="records", double_precision=15))
        return
    for title, table in tables(result).items():
        print(title, table.to_string(index=False, na_rep=""), sep="\n", end="\n\n")
    if (result.judged.reason == "ambiguous").any():
        print("After a jump a spot is ambiguous; --unrelated measures each image by itself.")
