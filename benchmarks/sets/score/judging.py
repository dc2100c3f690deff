"""Outcome and errors of each image, and their summary for all images and by condition."""

import functools
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from enum import StrEnum
from itertools import pairwise
from typing import Any, Literal

import numpy as np
import pandas as pd

from eyespot.benchmarks.paper import ELLIPSE, VISIBLE_ENOUGH
from eyespot.benchmarks.sets.read import SetStack
from eyespot.formats.inputs import InputError
from eyespot.formats.microscope import read_microscope
from eyespot.formats.spot import PARAMETERS
from eyespot.formats.spots import SpotRecord, spots_table

# The images of a set with their labels, and the conditions by which they are grouped.

ALL = "all"  # condition and group of all images together


def images_of(stacks: Iterable[SetStack]) -> pd.DataFrame:
    """All images of a set, by their names in the set: the labels, and what groups them.

    `stack` is SPLIT/STACK; `split` is empty for a single stack, `adverse` in splits without
    conditions, `pair` in a set without pairs, `viewing` for a pinhole.
    """
    rows, stacks = {}, list(stacks)
    first = "first" if any(entry.pair for entry in stacks) else ""
    for entry in stacks:
        stack = entry.open()
        viewing = stack.description["scene"].get("viewing", {})  # not in stacks of eyespot 0.1
        bare = viewing.get("eye", "none") == "none"
        about = {
            "stack": entry.qualified_name,
            "split": entry.split,
            "adverse": entry.condition or "",
            "pair": entry.pair or first,
            "viewing": "" if bare else f"{viewing['lens']}, {viewing['form']}",
            "scale_mm_px": read_microscope(entry.folder / "microscope.json").scale_mm_px,
            "source": stack.described("scene.source.kind", str),
            "wall": stack.described("scene.phantom.wall", str),
        }
        for labels in stack.labels:
            rows[entry.image_name(labels.file_name)] = vars(labels) | about
    return with_derived(pd.DataFrame.from_dict(rows, orient="index"))


def with_derived(images: pd.DataFrame) -> pd.DataFrame:
    """With the incidence in degrees, and the tip's path at the retinal pole in the exposure, px."""
    return images.assign(
        incidence_deg=np.degrees(images.incidence_rad),
        blur_px=images.speed_mm_s * images.exposure_s / images.scale_mm_px,
    )


_ORDER = ("train", "validation", "test", "adverse", "unseen", "first")
"""Of groups by value; others follow by name."""

CONDITIONS: dict[str, tuple[float, ...]] = {
    **dict.fromkeys(("split", "adverse", "pair", "viewing", "source", "wall", "exposure"), ()),
    "medium": (),
    "c_mm": (0, 2, 4, 6),
    "d_mm": (0, 1, 2, 4, 6),
    "incidence_deg": (0, 15, 30, 45),
    "speed_mm_s": (0, 0.5, 1.5, 5),
    "blur_px": (0, 0.5, 2, 8),
    "visible_fraction": (0, 0.5, 0.75, 0.95),
    "saturated_fraction": (0, 0.001, 0.1, 0.5),
}
"""Columns by which images are grouped: by their values, or in bins [edge, next edge), of which the
last one has no upper limit."""


def groups(images: pd.DataFrame, condition: str) -> pd.Series:
    """The group of each image by a condition, in the order of the groups; missing without one."""
    if condition == ALL:
        return pd.Series(ALL, images.index, dtype="category")
    edges, values = CONDITIONS[condition], images[condition]
    if edges:
        order = [*(f"{low:g}–{high:g}" for low, high in pairwise(edges)), f"≥ {edges[-1]:g}"]
        # Labels such as c = 0 may have rounding errors of either sign.
        bins = np.searchsorted(edges, values + 1e-9, side="right") - 1
        values = pd.Series(np.array(order)[np.maximum(bins, 0)], index=values.index)
    else:
        place = {group: index for index, group in enumerate(_ORDER)}
        order = sorted(set(values) - {""}, key=lambda group: (place.get(group, len(place)), group))
    return values.where(values != "").astype(pd.CategoricalDtype(order, ordered=True))


Against = Literal["half_max", "cone"]

CENTRE = "centre_px"  # The distance between the centres is the only quantity without a sign.
ANGLE = "angle_rad"  # The semi-major axis's; scored where the true ellipse is not round.
QUANTITIES = ("x_px", "y_px", CENTRE, "semi_major_px", "semi_minor_px", ANGLE, "distance_mm")
"""Scored quantities; the true distance is d = |SO|."""
MAIN = "semi_minor_px"  # It determines distances, and groups are compared by it.

_NAMES = dict(zip(ELLIPSE, PARAMETERS, strict=True))
"""Names in the covariance of a spot."""
_LEAST_DIFFERENCE_PX = 1.0  # Of rounder spots an error of 0.05 px may turn the axes by 3 degrees.
_RESAMPLES = 1000  # The ends of an interval vary by 3 % of its width.
_FEWEST_STACKS = 3  # Fewer are not enough for a bootstrap.


class Outcome(StrEnum):
    """Outcome of an image.

    A spot is the true spot if its centre lies within one true semi-major axis of the true centre. A
    distance without an ellipse counts as the true spot, since nothing says where it was read.
    """

    # At least half of the contour is visible; reported are
    FOUND = "found"  # the true spot
    MISSED = "missed"  # no spot
    MISPLACED = "misplaced"  # a spot elsewhere: missed and a false spot
    # Less than half is visible; reported are
    HIDDEN = "hidden"  # no spot
    GLIMPSED = "glimpsed"  # the true spot; its errors are not counted
    INVENTED = "invented"  # a spot elsewhere, or any where nothing is visible


def judge(
    images: pd.DataFrame, records: Mapping[str, SpotRecord], *, against: Against
) -> pd.DataFrame:
    """Compare an estimator's records with the labels of a set.

    If the records contain one image of a split and exposure, all images of that split and exposure
    count. An image without a record counts as an image without a spot.

    Returns:
        The images that count, with `outcome`, `reason` of a missing spot, and for each quantity
        `error` (estimate - truth, of found images) and `sigma`, such as `error_x_px`.
    """
    kinds = images.split + "\n" + images.exposure
    counted = images[kinds.isin(kinds[list(records)])]
    spots = spots_table(records.values()).set_index("file_name").reindex(counted.index)
    is_spot = spots.status == "spot"
    errors = pd.DataFrame(
        {q: spots[q] - counted[f"{against}_{q}"] for q in ELLIPSE}
        | {"distance_mm": spots.distance_mm - counted.d_mm}
    )
    errors[CENTRE] = np.hypot(errors.x_px, errors.y_px)
    axes = counted[f"{against}_semi_major_px"] - counted[f"{against}_semi_minor_px"]
    half_turn = math.pi / 2  # an axis has no sign, so that its error is at most this
    errors[ANGLE] = (errors[ANGLE] + half_turn) % math.pi - half_turn
    errors[ANGLE] = errors[ANGLE].where(axes >= _LEAST_DIFFERENCE_PX)
    visible = counted.visible_fraction >= VISIBLE_ENOUGH
    nothing = ~is_spot & spots.distance_mm.isna()
    # `not <=` includes NaN: a spot without a position is elsewhere.
    elsewhere = is_spot & ~(errors[CENTRE] <= counted[f"{against}_semi_major_px"])
    invented = elsewhere | (counted.visible_fraction == 0)
    seen = np.select([nothing, elsewhere], [Outcome.MISSED, Outcome.MISPLACED], Outcome.FOUND)
    unseen = np.select([nothing, invented], [Outcome.HIDDEN, Outcome.INVENTED], Outcome.GLIMPSED)
    outcome = pd.Series(np.where(visible, seen, unseen), counted.index)
    sigmas = {f"sigma_{q}": np.sqrt(spots[f"cov_{n}_{n}"]) for q, n in _NAMES.items()}
    return counted.assign(
        outcome=outcome,
        reason=spots.reason.fillna("no line"),
        **{f"error_{q}": errors[q].where(outcome == Outcome.FOUND) for q in QUANTITIES},
        **sigmas | {f"sigma_{CENTRE}": math.nan, "sigma_distance_mm": spots.sigma_distance_mm},
    )


def counts_of(judged: pd.DataFrame) -> pd.DataFrame:
    """Numbers of images by outcome, a row for each estimator and group.

    `visible`: half of the contour or more is visible; `found` and `missed` are of these, `glimpsed`
    is with the true spot of the `hidden` ones; `false_spots` are at a wrong position.
    """
    by_group = judged.groupby(["estimator", "group"], observed=True)
    of = by_group.outcome.value_counts().unstack(fill_value=0)
    of = of.reindex(columns=[*Outcome], fill_value=0)
    missed = of[Outcome.MISSED] + of[Outcome.MISPLACED]
    images, visible = of.sum(axis=1), of[Outcome.FOUND] + missed
    return pd.DataFrame(
        {
            "images": images,
            "visible": visible,
            "found": of[Outcome.FOUND],
            "missed": missed,
            "false_spots": of[Outcome.MISPLACED] + of[Outcome.INVENTED],
            "hidden": images - visible,
            "glimpsed": of[Outcome.GLIMPSED],
        }
    ).reset_index()


def errors_of(judged: pd.DataFrame) -> pd.DataFrame:
    """Errors over the found images, a row for each estimator, group and quantity with a value.

    `bias` is NaN for the distance between centres, which has no sign.
    """
    about = judged[["estimator", "group", "stack"]]
    every = pd.concat(
        about.assign(quantity=q, error=judged[f"error_{q}"], sigma=judged[f"sigma_{q}"])
        for q in QUANTITIES
    )
    known = every[np.isfinite(every.error)].astype({"quantity": pd.CategoricalDtype([*QUANTITIES])})
    by_quantity = known.groupby(["estimator", "group", "quantity"], observed=True)
    found = by_quantity[["stack", "error", "sigma"]].apply(error_summary)
    found = found.reindex(columns=_SUMMARY).reset_index()
    found.loc[found.quantity == CENTRE, "bias"] = math.nan
    return found.astype({"quantity": str, "n": "Int64", "n_sigma": "Int64"})


def error_summary(found: pd.DataFrame) -> pd.Series:
    """Errors of one quantity over images, in its unit: the columns stack, error and sigma.

    The 95 % intervals are by a bootstrap over stacks, NaN for fewer than three stacks. The parts
    within 1 σ and 2 σ are of the `n_sigma` images with a σ; they are 0.683 and 0.954 for normal
    errors and correct σ, as `z_std`, that of error/σ, is 1.
    """
    errors, sigmas = found[["error", "sigma"]].to_numpy(float).T
    stated = (sigmas > 0) & np.isfinite(sigmas)
    z = errors[stated] / sigmas[stated]
    resampled = _Resampled(found["stack"].to_numpy(str))
    size = np.sqrt(resampled.mean(errors**2, np.ones_like(stated)))
    parts = {
        f"within_{k}_sigma": resampled.mean(np.abs(errors) <= k * sigmas, stated) for k in (1, 2)
    }
    return pd.Series(
        {
            "n": errors.size,
            "bias": errors.mean(),
            **_interval("rmse", size),
            "median_abs": np.median(np.abs(errors)),
            "max_abs": np.abs(errors).max(),
            "n_sigma": z.size,
            "z_mean": z.mean() if z.size else math.nan,
            "z_std": z.std(ddof=1) if z.size > 1 else math.nan,
            **{
                name: value
                for part, own in parts.items()
                for name, value in _interval(part, own).items()
            },
        }
    )


_KEYS = ["estimator", "condition", "group"]
_SUMMARY = (
    "n bias rmse rmse_low rmse_high median_abs max_abs n_sigma z_mean z_std "
    "within_1_sigma within_1_low within_1_high within_2_sigma within_2_low within_2_high"
).split()


@dataclass(frozen=True, kw_only=True)
class Score:
    """Scores of estimators on a set, against one of the two true ellipses.

    Attributes:
        judged: images of all estimators, see `judge`, with the column `estimator`.
        left_out: number of images in splits and exposures for which an estimator has no spots.
        counts: by estimator, condition and group, see `counts_of`; ALL is both of all images.
        errors: the same by quantity, see `error_summary`; quantities without a value are left out.
    """

    against: Against
    judged: pd.DataFrame
    left_out: Mapping[str, int]
    counts: pd.DataFrame
    errors: pd.DataFrame

    def __repr__(self) -> str:
        return self._overall.to_string(index=False)

    def _repr_html_(self) -> str:
        """The errors over all images, for notebooks."""
        return self._overall.to_html(index=False)

    @property
    def _overall(self) -> pd.DataFrame:
        columns = ["estimator", "quantity", "n", "bias", "rmse", "within_2_sigma"]
        return self.errors[self.errors.condition == ALL][columns]

    @property
    def by_condition(self) -> pd.DataFrame:
        """Counts with the errors of the main quantity; conditions with one group are omitted."""
        of = self.counts[self.counts.condition != ALL]
        several = of.groupby("condition").group.transform("nunique") > 1
        return of[several].merge(self.errors[self.errors.quantity == MAIN], "left", on=_KEYS)

    @property
    def table(self) -> pd.DataFrame:
        """Content of score.csv."""
        table = self.counts.merge(self.errors, "left", on=_KEYS)
        table.insert(1, "against", self.against)
        return table


def score(
    images: pd.DataFrame, spots: Mapping[str, Mapping[str, SpotRecord]], *, against: Against
) -> Score:
    """Compare each estimator's records by image (`read_set_spots`) with the labels of a set."""
    of_each = {name: judge(images, records, against=against) for name, records in spots.items()}
    judged = pd.concat([found.assign(estimator=name) for name, found in of_each.items()])
    in_order = pd.CategoricalDtype([*of_each])
    counts, errors = [], []
    for condition in (ALL, *CONDITIONS):
        own = judged.astype({"estimator": in_order}).assign(group=groups(judged, condition))
        counts.append(counts_of(own).assign(condition=condition))
        errors.append(errors_of(own).assign(condition=condition))
    tables = (pd.concat(part, ignore_index=True) for part in (counts, errors))
    by_group, summary = (t[[*_KEYS, *t.columns.difference(_KEYS, sort=False)]] for t in tables)
    return Score(
        against=against,
        judged=judged,
        left_out={name: len(images) - len(found) for name, found in of_each.items()},
        counts=by_group.astype({"estimator": str}),
        errors=summary.astype({"estimator": str}),
    )


# Standings of estimators on the same images, with intervals by a bootstrap over stacks.

_MEDIAN_OF_NORMAL_SIGMAS = 0.6745
_BOUNDS = {"semi_minor_px": "bound_semi_minor_px", "distance_mm": "bound_d_mm"}
"""Label with the bound of a quantity."""
_SIGMAS_OF_95_PERCENT = 1.96
_VISIBLE = (Outcome.FOUND, Outcome.MISSED, Outcome.MISPLACED)


def standings(judged: pd.DataFrame, quantity: str) -> pd.DataFrame:
    """Rank the entries that measure a quantity, on the images that all of them cover.

    The columns are those that docs/leaderboard.md explains, each with the ends of its 95 % interval
    beside it, such as `median_low` and `median_high`; NaN if unknown. The rows are by `condition`
    and `group`, in the order of the ranks; conditions with one group are left out. There are none
    if no entry measures the quantity. An entry that finds no spot is the last on the ellipse.

    Raises:
        InputError: the entries have no image in common.
    """
    has_error = judged[f"error_{quantity}"].notna().groupby(judged.estimator).transform("any")
    if not has_error.any():
        return pd.DataFrame()
    finds = (judged.outcome == Outcome.FOUND).groupby(judged.estimator).transform("any")
    taking_part = judged[has_error | (~finds & (quantity != "distance_mm"))]
    covering = taking_part.groupby(["stack", "file_name"]).estimator.transform("nunique")
    common = taking_part[covering == taking_part.estimator.nunique()]
    if common.empty:
        raise InputError(
            "the entries cover no image together: each has spots of other splits or exposures. "
            "Score them one by one."
        )
    # The images of every entry have one order, so that they are resampled alike.
    common = common.sort_values(["stack", "file_name"], ignore_index=True)
    placed = []
    for condition in (ALL, *CONDITIONS):
        by_group = common.groupby(groups(common, condition), observed=True)
        if condition == ALL or by_group.ngroups > 1:
            for group, members in by_group:
                about = {"condition": condition, "group": group}
                ranked = _ranked(members, quantity)
                placed.append(ranked.assign(**about)[[*about, *ranked]])
    return pd.concat(placed, ignore_index=True)


def _ranked(judged: pd.DataFrame, quantity: str) -> pd.DataFrame:
    entries = dict([*judged.groupby("estimator", sort=False)])
    resampled = _Resampled(next(iter(entries.values()))["stack"].to_numpy(str))
    standing = {name: _standing(own, resampled, quantity) for name, own in entries.items()}
    medians = np.array([own["median"] for own in standing.values()])
    # 1 + the number of better entries, in each resample.
    ranks = 1.0 + (medians[None, :, :] < medians[:, None, :]).sum(axis=1)
    rows = []
    for (name, own), rank in zip(standing.items(), ranks, strict=True):
        visible = entries[name].outcome.isin(_VISIBLE).sum()
        row: dict[str, Any] = _interval("rank", rank) | {"entry": name, "visible": visible}
        for figure, samples in own.items():
            row |= _interval(figure, samples)
        rows.append(row)
    table = pd.DataFrame(rows).sort_values("rank", kind="stable", ignore_index=True)
    return table.astype({"rank": int})


def _standing(own: pd.DataFrame, resampled: "_Resampled", quantity: str) -> dict[str, np.ndarray]:
    """Each figure on all images and on the resamples."""
    missed = own.outcome.isin((Outcome.MISSED, Outcome.MISPLACED))
    found = own.outcome == Outcome.FOUND
    sizes = own[f"error_{quantity}"].abs().fillna(math.inf)
    errors = sizes.where(found | missed).to_numpy(float)
    seen, is_found = ~np.isnan(errors), np.isfinite(errors)
    # Outside of the images that count, errors are NaN or infinite; the weights remove them.
    known = np.where(is_found, errors, 0.0)
    sigmas = own[f"sigma_{quantity}"].to_numpy(float)
    stated = is_found & (sigmas > 0) & np.isfinite(sigmas)
    false = own.outcome.isin((Outcome.MISPLACED, Outcome.INVENTED)).to_numpy()
    part = np.divide(known, sigmas, out=np.full(known.shape, math.inf), where=stated)
    bound = own[_BOUNDS[quantity]].to_numpy(float) if quantity in _BOUNDS else math.nan
    ratio = errors / (_MEDIAN_OF_NORMAL_SIGMAS * bound)
    return {
        "missed": resampled.mean(~is_found, seen),
        "false_spots": resampled.mean(false, np.ones_like(seen)),
        "median": resampled.quantile(errors, seen, 0.5),
        "ninth_decile": resampled.quantile(errors, seen, 0.9),
        "rmse": np.sqrt(resampled.mean(known**2, is_found)),
        "within_1_sigma": resampled.mean(part <= 1, stated),
        "within_196_sigma": resampled.mean(part <= _SIGMAS_OF_95_PERCENT, stated),
        "over_bound": resampled.quantile(ratio, seen & ~np.isnan(ratio), 0.5),
    }


@functools.lru_cache(maxsize=32)
def _draws(stacks: int) -> np.ndarray:
    """How often each stack counts: once in the first row, then as drawn for each resample."""
    times = np.ones((1, stacks), dtype=np.int32)
    if stacks < _FEWEST_STACKS:
        return times
    rng = np.random.default_rng(0)
    drawn = rng.multinomial(stacks, np.full(stacks, 1 / stacks), size=_RESAMPLES)
    return np.concatenate([times, drawn.astype(np.int32)])


class _Resampled:
    """The images as they are, and with stacks drawn with replacement, the same for all entries.

    Images of a stack show the same wall and motion, so their errors are not independent.
    """

    def __init__(self, stacks: np.ndarray) -> None:
        names, self._stack = np.unique(stacks, return_inverse=True)
        self._times = _draws(names.size)

    def mean(self, values: np.ndarray, counted: np.ndarray) -> np.ndarray:
        """Mean over the counted images: first of all of them, then of each resample."""
        width = self._times.shape[1]
        totals = np.bincount(self._stack, values * counted, minlength=width)
        numbers = np.bincount(self._stack, counted, minlength=width)
        with np.errstate(invalid="ignore"):
            mean: np.ndarray = (self._times @ totals) / (self._times @ numbers)
        return mean

    def quantile(self, values: np.ndarray, counted: np.ndarray, part: float) -> np.ndarray:
        """Least value that is not below this part of the counted values, as of `mean`."""
        order = np.argsort(values[counted], kind="stable")
        if not order.size:
            return np.full(len(self._times), math.nan)
        upto = np.cumsum(self._times[:, self._stack[counted][order]], axis=1)
        place = np.argmax(upto >= part * upto[:, -1:], axis=1)
        chosen: np.ndarray = np.where(upto[:, -1] > 0, values[counted][order][place], math.nan)
        return chosen


def _interval(figure: str, samples: np.ndarray) -> dict[str, float]:
    """A figure from its value on all images, with an interval from the resamples."""
    drawn = samples[1:][~np.isnan(samples[1:])]
    low = high = math.nan
    if drawn.size:
        # No interpolation: a part of the resamples may be infinite.
        low, high = np.quantile(drawn, (0.025, 0.975), method="inverted_cdf").tolist()
    ends = figure.removesuffix("_sigma")
    return {figure: float(samples[0]), f"{ends}_low": low, f"{ends}_high": high}
