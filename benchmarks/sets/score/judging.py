"""Outcome and errors of each image, and their summary for all images and by condition."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, Literal

import numpy as np
import pandas as pd

from benchmarks.paper import VISIBLE_ENOUGH
from benchmarks.sets.score.images import ALL, CONDITIONS, groups
from estimator import Spot, SpotRecord

Against = Literal["half_max", "cone"]

CENTRE = "centre_px"
"""Distance between the centres, the only quantity without a sign."""
QUANTITIES = ("x_px", "y_px", CENTRE, "semi_major_px", "semi_minor_px", "distance_mm")
"""Scored quantities; the true distance is d = |SO|."""
MAIN = "semi_minor_px"
"""The quantity that determines distances, by which groups are compared."""

_ELLIPSE = {"x_px": 0, "y_px": 1, "semi_major_px": 2, "semi_minor_px": 3}
"""Index of a quantity in the covariance of a spot."""
_RESAMPLED = 1000  # bootstrap samples; the ends of an interval vary by 3 % of its width
_FEWEST_STACKS = 3  # fewer are not enough for a bootstrap


class Outcome(StrEnum):
    """Outcome of an image.

    A spot is the true spot if its centre lies within one true semi-major axis of the true centre. A
    distance without an ellipse counts as the true spot, since nothing says where it was read.
    """

    FOUND = "found"
    """At least half of the contour is visible, and the true spot is reported."""
    MISSED = "missed"
    """At least half is visible, and no spot is reported."""
    MISPLACED = "misplaced"
    """At least half is visible, and a spot elsewhere is reported: missed and a false spot."""
    HIDDEN = "hidden"
    """Less than half is visible, and no spot is reported."""
    GLIMPSED = "glimpsed"
    """Less than half is visible, and the true spot is reported; its errors are not counted."""
    INVENTED = "invented"
    """Less than half is visible and a spot elsewhere is reported, or nothing is visible."""


def judge(
    images: pd.DataFrame, records: Mapping[str, SpotRecord], *, against: Against
) -> pd.DataFrame:
    """Compare an estimator's records with the labels of a set.

    If the records contain one image of a split and exposure, all images of that split and exposure
    count. An image without a record counts as an image without a spot.

    Args:
        images: images of the set, see `images_of`.
        against: which of the two ellipses is the truth.

    Returns:
        The images that count, with `outcome`, `reason` of a missing spot, and for each quantity
        `error` (estimate - truth, of found images) and `sigma`, such as `error_x_px`.
    """
    kinds = images.split + "\n" + images.exposure
    counted = images[kinds.isin(kinds[list(records)])]
    spots = pd.DataFrame([_reported(records.get(name)) for name in counted.index], counted.index)
    errors = pd.DataFrame(
        {q: spots[q] - counted[f"{against}_{q}"] for q in _ELLIPSE}
        | {"distance_mm": spots.distance_mm - counted.d_mm}
    )
    errors[CENTRE] = np.hypot(errors.x_px, errors.y_px)
    visible = counted.visible_fraction >= VISIBLE_ENOUGH
    nothing = ~spots.spot & spots.distance_mm.isna()
    # `not <=` includes NaN: a spot without a position is elsewhere.
    elsewhere = spots.spot & ~(errors[CENTRE] <= counted[f"{against}_semi_major_px"])
    invented = elsewhere | (counted.visible_fraction == 0)
    seen = np.select([nothing, elsewhere], [Outcome.MISSED, Outcome.MISPLACED], Outcome.FOUND)
    unseen = np.select([nothing, invented], [Outcome.HIDDEN, Outcome.INVENTED], Outcome.GLIMPSED)
    outcome = pd.Series(np.where(visible, seen, unseen), counted.index)
    return counted.assign(
        outcome=outcome,
        reason=spots.reason,
        **{f"error_{q}": errors[q].where(outcome == Outcome.FOUND) for q in QUANTITIES},
        **{f"sigma_{q}": spots[f"sigma_{q}"] for q in QUANTITIES},
    )


def _reported(record: SpotRecord | None) -> dict[str, Any]:
    """What a record reports, NaN for what it does not."""
    spot = record.result if record is not None and isinstance(record.result, Spot) else None
    ellipse: dict[str, float] = dict.fromkeys(_ELLIPSE, math.nan)
    sigmas = dict.fromkeys((f"sigma_{q}" for q in QUANTITIES), math.nan)
    if spot is not None:
        ellipse = {q: getattr(spot, q) for q in _ELLIPSE}
        sigmas |= {f"sigma_{q}": math.sqrt(spot.covariance[i, i]) for q, i in _ELLIPSE.items()}
    if record is not None:
        sigmas["sigma_distance_mm"] = record.sigma_distance_mm
    return {
        "spot": spot is not None,
        "reason": record.reason if record else "no line",
        **ellipse,
        "distance_mm": record.distance_mm if record else math.nan,
        **sigmas,
    }


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
    z = z_scores(known, quantity)
    low, high = _rmse_interval(errors, known["stack"].to_numpy(str))
    one, two = (_part(np.abs(z) <= k) for k in (1, 2))
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
        **dict(zip(("within_1_sigma", "within_1_low", "within_1_high"), one, strict=True)),
        **dict(zip(("within_2_sigma", "within_2_low", "within_2_high"), two, strict=True)),
    }


def z_scores(judged: pd.DataFrame, quantity: str) -> np.ndarray:
    """Error/σ of the found images that have both."""
    errors, sigmas = (judged[f"{of}_{quantity}"].to_numpy(float) for of in ("error", "sigma"))
    usable = np.isfinite(errors) & (sigmas > 0) & np.isfinite(sigmas)
    return errors[usable] / sigmas[usable]


def _rmse_interval(errors: np.ndarray, stacks: np.ndarray) -> tuple[float, float]:
    """95 % interval of the RMSE; stacks are resampled, as errors within a stack are correlated."""
    names, index = np.unique(stacks, return_inverse=True)
    if names.size < _FEWEST_STACKS:
        return math.nan, math.nan
    squares, images = np.bincount(index, errors**2), np.bincount(index)
    drawn = np.random.default_rng(0).integers(names.size, size=(_RESAMPLED, names.size))
    rmse = np.sqrt(squares[drawn].sum(axis=1) / images[drawn].sum(axis=1))
    low, high = np.percentile(rmse, (2.5, 97.5))
    return float(low), float(high)


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
    """Scores of estimators on a set.

    Attributes:
        against: which of the two ellipses is the truth.
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
    """Compare estimators' spots with the labels of a set.

    Args:
        images: images of the set, see `images_of`.
        spots: records of each estimator by image name, see `read_set_spots`.
        against: which of the two ellipses is the truth.
    """
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
