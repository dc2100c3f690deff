"""Outcome and errors of each image, and their summary for all images and by condition."""

import math
from collections.abc import Iterable, Iterator, Mapping
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
from eyespot.formats.spots import PARAMETERS, SpotRecord, spots_table

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


def groups(images: pd.DataFrame, condition: str) -> Iterator[tuple[str, pd.DataFrame]]:
    """The images of each group of a condition, in order; those without a group are left out."""
    if condition == ALL:
        yield ALL, images
        return
    edges, values = CONDITIONS[condition], images[condition]
    if edges:
        order = [*(f"{low:g}–{high:g}" for low, high in pairwise(edges)), f"≥ {edges[-1]:g}"]
        # Labels such as c = 0 may have rounding errors of either sign.
        bins = np.searchsorted(edges, values + 1e-9, side="right") - 1
        values = pd.Series(np.array(order)[np.maximum(bins, 0)], index=values.index)
    else:
        place = {group: index for index, group in enumerate(_ORDER)}
        order = sorted(set(values) - {""}, key=lambda group: (place.get(group, len(place)), group))
    for group in order:
        if (members := values == group).any():
            yield group, images[members]


Against = Literal["half_max", "cone"]

CENTRE = "centre_px"  # distance between the centres, the only quantity without a sign
ANGLE = "angle_rad"  # of the semi-major axis; scored where the true ellipse is not round
QUANTITIES = ("x_px", "y_px", CENTRE, "semi_major_px", "semi_minor_px", ANGLE, "distance_mm")
"""Scored quantities; the true distance is d = |SO|."""
MAIN = "semi_minor_px"  # which determines distances, and by which groups are compared

_NAMES = dict(zip(ELLIPSE, PARAMETERS, strict=True))  # in the covariance of a spot
_ROUND_PX = 1.0  # axes that differ less; an error of 0.05 px in them may turn it by 3 degrees
_RESAMPLED = 1000  # bootstrap samples; the ends of an interval vary by 3 % of its width
_FEWEST_STACKS = 3  # fewer are not enough for a bootstrap


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
    errors[ANGLE] = errors[ANGLE].where(axes >= _ROUND_PX)
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


def counts_of(judged: pd.DataFrame) -> dict[str, int]:
    """Numbers of images by outcome.

    `visible`: half of the contour or more is visible; `found` and `missed` are of these, `glimpsed`
    is with the true spot of the `hidden` ones; `false_spots` are at a wrong position.
    """
    of = judged.outcome.value_counts().reindex([*Outcome], fill_value=0)
    missed = int(of[Outcome.MISSED] + of[Outcome.MISPLACED])
    visible = int(of[Outcome.FOUND]) + missed
    return {
        "images": len(judged),
        "visible": visible,
        "found": visible - missed,
        "missed": missed,
        "false_spots": int(of[Outcome.MISPLACED] + of[Outcome.INVENTED]),
        "hidden": len(judged) - visible,
        "glimpsed": int(of[Outcome.GLIMPSED]),
    }


def error_summary(judged: pd.DataFrame, quantity: str) -> dict[str, Any]:
    """Errors of one quantity over the found images, in its unit; `n` is 0 if none has it.

    `bias` is NaN for the distance between centres, which has no sign. The 95 % intervals are by a
    bootstrap over stacks for `rmse`, NaN for fewer than three stacks, and exact (Clopper and
    Pearson 1934) for the parts within 1 σ and 2 σ of the `n_sigma` images with a σ; these are 0.683
    and 0.954 for normal errors and correct σ, as `z_std`, that of error/σ, is 1.
    """
    known = judged[np.isfinite(judged[f"error_{quantity}"])]
    errors = known[f"error_{quantity}"].to_numpy(float)
    if not errors.size:
        return {"quantity": quantity, "n": 0}
    sigmas = known[f"sigma_{quantity}"].to_numpy(float)
    stated = (sigmas > 0) & np.isfinite(sigmas)
    z = errors[stated] / sigmas[stated]
    low = high = math.nan
    names, index = np.unique(known["stack"].to_numpy(str), return_inverse=True)
    if names.size >= _FEWEST_STACKS:
        # Stacks are resampled, because errors within a stack are correlated.
        squares, images = np.bincount(index, errors**2), np.bincount(index)
        drawn = np.random.default_rng(0).integers(names.size, size=(_RESAMPLED, names.size))
        rmse = np.sqrt(squares[drawn].sum(axis=1) / images[drawn].sum(axis=1))
        low, high = np.percentile(rmse, (2.5, 97.5)).tolist()
    inside = dict[str, float]()
    for k in (1, 2):
        ends = (f"within_{k}_{name}" for name in ("sigma", "low", "high"))
        inside |= zip(ends, _part(np.abs(z) <= k), strict=True)
    return {
        "quantity": quantity,
        "n": errors.size,
        "bias": math.nan if quantity == CENTRE else float(errors.mean()),
        "rmse": math.sqrt(np.mean(errors**2)),
        "rmse_low": low,
        "rmse_high": high,
        "median_abs": float(np.median(np.abs(errors))),
        "max_abs": float(np.abs(errors).max()),
        "n_sigma": z.size,
        "z_mean": float(z.mean()) if z.size else math.nan,
        "z_std": float(z.std(ddof=1)) if z.size > 1 else math.nan,
        **inside,
    }


def _part(inside: np.ndarray) -> tuple[float, float, float]:
    """Fraction of true values, and its exact binomial 95 % interval."""
    if not inside.size:
        return math.nan, math.nan, math.nan
    from scipy.stats import binomtest  # 0.5 s

    result = binomtest(int(inside.sum()), inside.size)
    interval = result.proportion_ci(0.95, method="exact")
    return float(inside.mean()), float(interval.low), float(interval.high)


_KEYS = ["estimator", "condition", "group"]
_SUMMARY = (
    "quantity n bias rmse rmse_low rmse_high median_abs max_abs n_sigma z_mean z_std "
    "within_1_sigma within_1_low within_1_high within_2_sigma within_2_low within_2_high"
).split()


@dataclass(frozen=True, kw_only=True)
class Score:
    """Scores of estimators on a set, against one of the two true ellipses.

    Attributes:
        judged: images of each estimator, see `judge`.
        left_out: number of images in splits and exposures for which an estimator has no spots.
        counts: by estimator, condition and group, see `counts_of`; ALL is both of all images.
        errors: the same by quantity, see `error_summary`; quantities without a value are left out.
    """

    against: Against
    judged: Mapping[str, pd.DataFrame]
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
    judged = {name: judge(images, records, against=against) for name, records in spots.items()}
    counts, errors = [], []
    for condition in (ALL, *CONDITIONS):
        for name, found in judged.items():
            for group, members in groups(found, condition):
                key = dict(zip(_KEYS, (name, condition, group), strict=True))
                counts.append(key | counts_of(members))
                errors += [key | error_summary(members, quantity) for quantity in QUANTITIES]
    summary = pd.DataFrame(errors, columns=[*_KEYS, *_SUMMARY])
    summary = summary[summary.n > 0].astype({"n": "Int64", "n_sigma": "Int64"})
    return Score(
        against=against,
        judged=judged,
        left_out={name: len(images) - len(found) for name, found in judged.items()},
        counts=pd.DataFrame(counts),
        errors=summary.reset_index(drop=True),
    )


# Standings of estimators on the same images, with intervals by a bootstrap over stacks.

_MEDIAN_OF_NORMAL = 0.6745  # of the absolute value, in sigmas
_BOUNDS = {"semi_minor_px": "bound_semi_minor_px", "distance_mm": "bound_d_mm"}
"""Label with the bound of a quantity."""
_WIDE = 1.96  # sigmas that contain 95 % of normal errors


def standings(judged: Mapping[str, pd.DataFrame], quantity: str) -> pd.DataFrame:
    """Rank the entries that measure a quantity, on the images that all of them cover.

    The columns are those that docs/leaderboard.md explains, each with the ends of its 95 % interval
    beside it, such as `median_low` and `median_high`; NaN if unknown. The rows are by `condition`
    and `group`, in the order of the ranks; conditions with one group are left out. There are none
    if no entry measures the quantity. An entry that finds no spot is the last on the ellipse.

    Raises:
        InputError: the entries have no image in common.
    """
    column = f"error_{quantity}"
    has_errors = {name: np.isfinite(own[column]).any() for name, own in judged.items()}
    if not any(has_errors.values()):
        return pd.DataFrame()
    measuring = {
        name: own.set_index(["stack", "file_name"], drop=False)
        for name, own in judged.items()
        if has_errors[name]
        or (quantity != "distance_mm" and not (own.outcome == Outcome.FOUND).any())
    }
    first, *others = measuring.values()
    common = first.index
    for own in others:
        common = common[common.isin(own.index)]
    if not len(common):
        raise InputError(
            "the entries cover no image together: each has spots of other splits or exposures. "
            "Score them one by one."
        )
    shared = {name: own.loc[common] for name, own in measuring.items()}
    placed = []
    for condition in (ALL, *CONDITIONS):
        found = list(groups(first.loc[common], condition))
        if condition == ALL or len(found) > 1:
            for group, members in found:
                of = {name: own.loc[members.index] for name, own in shared.items()}
                ranked = _ranked(of, quantity)
                ranked.insert(0, "condition", condition)
                ranked.insert(1, "group", group)
                placed.append(ranked)
    return pd.concat(placed, ignore_index=True)


def _ranked(judged: Mapping[str, pd.DataFrame], quantity: str) -> pd.DataFrame:
    resampled = _Resampled(next(iter(judged.values()))["stack"].to_numpy(str))
    standing = {name: _standing(own, resampled, quantity) for name, own in judged.items()}
    medians = np.array([own["median"] for own in standing.values()])
    # 1 + the number of better entries, in each resample.
    ranks = 1.0 + (medians[None, :, :] < medians[:, None, :]).sum(axis=1)
    rows = []
    for (name, own), rank in zip(standing.items(), ranks, strict=True):
        row: dict[str, Any] = _interval("rank", rank)
        row |= {"entry": name, "visible": counts_of(judged[name])["visible"]}
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
    ratio = errors / (_MEDIAN_OF_NORMAL * bound)
    return {
        "missed": resampled.mean(~is_found, seen),
        "false_spots": resampled.mean(false, np.ones_like(seen)),
        "median": resampled.quantile(errors, seen, 0.5),
        "ninth_decile": resampled.quantile(errors, seen, 0.9),
        "rmse": np.sqrt(resampled.mean(known**2, is_found)),
        "within_1_sigma": resampled.mean(part <= 1, stated),
        "within_196_sigma": resampled.mean(part <= _WIDE, stated),
        "over_bound": resampled.quantile(ratio, seen & ~np.isnan(ratio), 0.5),
    }


class _Resampled:
    """The images as they are, and with stacks drawn with replacement, the same for all entries.

    Images of a stack show the same wall and motion, so their errors are not independent.
    """

    def __init__(self, stacks: np.ndarray) -> None:
        names, self._stack = np.unique(stacks, return_inverse=True)
        count = names.size
        self._times = np.ones((1, count), dtype=np.int32)
        if count >= _FEWEST_STACKS:
            rng = np.random.default_rng(0)
            drawn = rng.multinomial(count, np.full(count, 1 / count), size=_RESAMPLED)
            self._times = np.concatenate([self._times, drawn.astype(np.int32)])

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
