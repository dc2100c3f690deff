"""How good an estimator is on a group of images: counts, errors, and how honest its σ are."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from benchmarks.sets.score.outcomes import CENTRE, QUANTITIES, Judged, Outcome

_RESAMPLED = 1000  # sets drawn for an interval; its ends scatter by 3 % of its width
_FEWEST_STACKS = 3  # with fewer there is nothing to draw from


class Counts(NamedTuple):
    """What became of a group's images.

    Attributes:
        images: that count.
        visible: with half of the contour or more in view.
        found: of the visible ones, with the true spot.
        missed: of the visible ones, without it.
        false_spots: reported where no spot is.
        hidden: with less than half of the contour in view.
        glimpsed: of the hidden ones, with the true spot nevertheless.
    """

    images: int
    visible: int
    found: int
    missed: int
    false_spots: int
    hidden: int
    glimpsed: int


class Errors(NamedTuple):
    """Errors (estimate - truth) of one quantity over the images found, in its unit.

    Attributes:
        quantity: what was measured, with its unit.
        n: images with a value.
        bias: mean; NaN for the distance between centres, which has no sign.
        rmse: root of the mean square.
        rmse_low: 95 % interval of the RMSE from stacks drawn anew (bootstrap); NaN for fewer than
            three stacks.
        rmse_high: its other end.
        median_abs: median of the absolute value.
        max_abs: the largest.
        n_sigma: images with a value and a standard deviation of it.
        z_mean: mean of error/σ; 0 if it is honest.
        z_std: standard deviation of error/σ; 1 if σ is honest.
        within_1_sigma: part of the errors below σ; 0.683 if it is honest and normal.
        within_1_low: 95 % interval of that part, exact (Clopper and Pearson 1934).
        within_1_high: its other end.
        within_2_sigma: part of the errors below 2σ; 0.954 if it is honest and normal.
        within_2_low: its interval.
        within_2_high: its other end.
    """

    quantity: str
    n: int
    bias: float
    rmse: float
    rmse_low: float
    rmse_high: float
    median_abs: float
    max_abs: float
    n_sigma: int
    z_mean: float
    z_std: float
    within_1_sigma: float
    within_1_low: float
    within_1_high: float
    within_2_sigma: float
    within_2_low: float
    within_2_high: float


def counts_of(images: Sequence[Judged]) -> Counts:
    """Count a group's outcomes."""
    of = Counter(image.outcome for image in images)
    missed = of[Outcome.MISSED] + of[Outcome.MISPLACED]
    visible = of[Outcome.FOUND] + missed
    return Counts(
        images=len(images),
        visible=visible,
        found=of[Outcome.FOUND],
        missed=missed,
        false_spots=of[Outcome.MISPLACED] + of[Outcome.INVENTED],
        hidden=len(images) - visible,
        glimpsed=of[Outcome.GLIMPSED],
    )


def errors_of(images: Sequence[Judged]) -> list[Errors]:
    """Errors of each quantity that was measured in a group, in the order of `QUANTITIES`."""
    found = [image for image in images if image.outcome is Outcome.FOUND]
    measured = []
    for quantity in QUANTITIES:
        errors = np.array([image.errors[quantity] for image in found])
        known = np.isfinite(errors)
        if known.any():
            stacks = np.array([image.circumstances.stack for image in found])[known]
            sigmas = np.array([image.sigmas.get(quantity, math.nan) for image in found])[known]
            measured.append(_errors(quantity, errors[known], stacks, sigmas))
    return measured


def z_scores(images: Sequence[Judged], quantity: str) -> np.ndarray:
    """Error/σ of the images found that have both."""
    pairs = [
        (image.errors[quantity], image.sigmas.get(quantity, math.nan))
        for image in images
        if image.outcome is Outcome.FOUND
    ]
    errors, sigmas = np.array(pairs).reshape(-1, 2).T
    return _z(errors, sigmas)


def _z(errors: np.ndarray, sigmas: np.ndarray) -> np.ndarray:
    usable = np.isfinite(errors) & (sigmas > 0) & np.isfinite(sigmas)
    return errors[usable] / sigmas[usable]


def _errors(quantity: str, errors: np.ndarray, stacks: np.ndarray, sigmas: np.ndarray) -> Errors:
    z = _z(errors, sigmas)
    low, high = _rmse_interval(errors, stacks)
    one, two = (_part(np.abs(z) <= k) for k in (1, 2))
    return Errors(
        quantity=quantity,
        n=errors.size,
        bias=math.nan if quantity == CENTRE else float(errors.mean()),
        rmse=math.sqrt(np.mean(errors**2)),
        rmse_low=low,
        rmse_high=high,
        median_abs=float(np.median(np.abs(errors))),
        max_abs=float(np.abs(errors).max()),
        n_sigma=z.size,
        z_mean=float(z.mean()) if z.size else math.nan,
        z_std=float(z.std(ddof=1)) if z.size > 1 else math.nan,
        within_1_sigma=one[0],
        within_1_low=one[1],
        within_1_high=one[2],
        within_2_sigma=two[0],
        within_2_low=two[1],
        within_2_high=two[2],
    )


def _rmse_interval(errors: np.ndarray, stacks: np.ndarray) -> tuple[float, float]:
    """95 % interval of the RMSE: images of one stack share what is wrong with them."""
    names, index = np.unique(stacks, return_inverse=True)
    if names.size < _FEWEST_STACKS:
        return math.nan, math.nan
    squares, images = np.bincount(index, errors**2), np.bincount(index)
    drawn = np.random.default_rng(0).integers(names.size, size=(_RESAMPLED, names.size))
    rmse = np.sqrt(squares[drawn].sum(axis=1) / images[drawn].sum(axis=1))
    low, high = np.percentile(rmse, (2.5, 97.5))
    return float(low), float(high)


def _part(inside: np.ndarray) -> tuple[float, float, float]:
    """Part that is true, and its exact binomial 95 % interval."""
    if not inside.size:
        return math.nan, math.nan, math.nan
    from scipy.stats import binomtest  # 0.5 s

    result = binomtest(int(inside.sum()), inside.size)
    interval = result.proportion_ci(0.95, method="exact")
    return float(inside.mean()), float(interval.low), float(interval.high)
