"""Counts, errors and calibration of σ for a group of images."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from benchmarks.sets.score.outcomes import CENTRE, QUANTITIES, Judged, Outcome

_RESAMPLED = 1000  # bootstrap samples; the ends of an interval vary by 3 % of its width
_FEWEST_STACKS = 3  # fewer are not enough for a bootstrap


class Counts(NamedTuple):
    """Numbers of images by outcome.

    Attributes:
        images: all images of the group.
        visible: images in which half of the contour or more is visible.
        found: visible images with the true spot.
        missed: visible images without the true spot.
        false_spots: spots reported at a wrong position.
        hidden: images in which less than half of the contour is visible.
        glimpsed: hidden images with the true spot.
    """

    images: int
    visible: int
    found: int
    missed: int
    false_spots: int
    hidden: int
    glimpsed: int


class Errors(NamedTuple):
    """Errors (estimate - truth) of one quantity over the found images, in its unit.

    Attributes:
        quantity: name of the quantity, with its unit.
        n: number of images with a value.
        bias: mean error; NaN for the distance between centres, which has no sign.
        rmse: root of the mean square error.
        rmse_low: lower end of the 95 % interval of the RMSE (bootstrap over stacks); NaN for fewer
            than three stacks.
        rmse_high: upper end.
        median_abs: median of the absolute error.
        max_abs: largest absolute error.
        n_sigma: number of images with a value and a standard deviation σ.
        z_mean: mean of error/σ; 0 without bias.
        z_std: standard deviation of error/σ; 1 if σ is correct.
        within_1_sigma: fraction of errors below σ; 0.683 for normal errors and correct σ.
        within_1_low: lower end of its exact 95 % interval (Clopper and Pearson 1934).
        within_1_high: upper end.
        within_2_sigma: fraction of errors below 2σ; 0.954 for normal errors and correct σ.
        within_2_low: lower end of its interval.
        within_2_high: upper end.
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
    """Count the outcomes of a group."""
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
    """Error/σ of the found images that have both."""
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
