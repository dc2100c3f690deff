"""Standings of estimators on the same images, with intervals by a bootstrap over stacks."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from benchmarks.sets.score.conditions import CONDITIONS
from benchmarks.sets.score.groups import ALL
from benchmarks.sets.score.measures import counts_of
from benchmarks.sets.score.outcomes import Judged, Outcome
from optics import InputError

_RESAMPLED = 1000  # the ends of a 95 % interval vary by 3 % of its width
_FEWEST_STACKS = 3  # fewer are not enough for a bootstrap
_MEDIAN_OF_NORMAL = 0.6745  # of the absolute value, in sigmas
_BOUNDS = {"semi_minor_px": "bound_semi_minor_px", "distance_mm": "bound_d_mm"}
"""Label with the bound of a quantity."""
_WIDE = 1.96  # sigmas that contain 95 % of normal errors


class Figure(NamedTuple):
    """A figure with the ends of its 95 % interval; NaN if unknown."""

    value: float = math.nan
    low: float = math.nan
    high: float = math.nan


class Standing(NamedTuple):
    """How one entry compares with the others on a group of images.

    Attributes:
        entry: name of the entry.
        rank: 1 has the least median error; of equal medians all have the lower rank.
        visible: number of images in which half of the contour or more is visible.
        missed: fraction of them without the true spot.
        false_spots: spots at a wrong place, per image.
        median: median of the absolute error over the visible images. The error of a missed image
            counts as infinite, so that leaving difficult images out does not help.
        ninth: 90th percentile of the same errors.
        rmse: root of the mean square error of the found images.
        within_1: fraction of the errors below the stated σ; 0.683 if σ is right.
        within_196: fraction below 1.96 σ; 0.950 if σ is right.
        over_bound: median of the absolute error divided by the image's Cramér-Rao bound, as a
            multiple of the median of a normal error of that size: 1 cannot be beaten without bias.
            NaN if the labels have no bound.
    """

    entry: str
    rank: Figure
    visible: int
    missed: Figure
    false_spots: Figure
    median: Figure
    ninth: Figure
    rmse: Figure
    within_1: Figure
    within_196: Figure
    over_bound: Figure


Standings = dict[tuple[str, str], list[Standing]]
"""Standings by condition and group, each in the order of the ranks."""


def standings(judged: Mapping[str, Sequence[Judged]], quantity: str) -> Standings:
    """Rank the entries that measure a quantity, on the images that all of them cover.

    Args:
        judged: outcomes of each entry.
        quantity: one of `QUANTITIES`.

    Returns:
        Standings on all images, and by condition; conditions with one group are left out. Empty if
        no entry measures the quantity. An entry that finds no spot is the last on the ellipse.

    Raises:
        InputError: the entries have no image in common.
    """
    measuring = {name: images for name, images in judged.items() if _measures(images, quantity)}
    if not any(_has_errors(images, quantity) for images in measuring.values()):
        return {}
    shared = _shared(measuring)
    return {
        (condition, group): _ranked(
            {name: [images[place] for place in places] for name, images in shared.items()}, quantity
        )
        for condition, group, places in _groups(shared)
    }


def _measures(images: Sequence[Judged], quantity: str) -> bool:
    finds_nothing = not any(image.outcome is Outcome.FOUND for image in images)
    return _has_errors(images, quantity) or (finds_nothing and quantity != "distance_mm")


def _has_errors(images: Sequence[Judged], quantity: str) -> bool:
    return any(math.isfinite(image.errors.get(quantity, math.nan)) for image in images)


def _shared(judged: Mapping[str, Sequence[Judged]]) -> dict[str, list[Judged]]:
    """The images that all entries cover, in the same order."""
    by_image = {
        name: {(i.circumstances.stack, i.circumstances.labels.file_name): i for i in images}
        for name, images in judged.items()
    }
    names = [set(images) for images in by_image.values()]
    common = set.intersection(*names) if names else set()
    if names and not common:
        raise InputError(
            "the entries cover no image together: each has spots of other splits or exposures. "
            "Score them one by one."
        )
    return {
        name: [image for key, image in images.items() if key in common]
        for name, images in by_image.items()
    }


def _groups(shared: Mapping[str, Sequence[Judged]]) -> Iterator[tuple[str, str, Sequence[int]]]:
    """Condition, group and places of the images of each group."""
    if not shared:
        return
    images = [image.circumstances for image in next(iter(shared.values()))]
    yield ALL, ALL, range(len(images))
    for condition in CONDITIONS:
        groups = condition.groups(images)
        if len(groups) > 1:
            of = [condition.group_of(image) for image in images]
            for group in groups:
                yield condition.name, group, [n for n, own in enumerate(of) if own == group]


def _ranked(judged: Mapping[str, Sequence[Judged]], quantity: str) -> list[Standing]:
    images = next(iter(judged.values()))
    resampled = _Resampled([image.circumstances.stack for image in images])
    medians = []
    found = []
    for name, own in judged.items():
        errors = np.array([_absolute_error(image, quantity) for image in own])
        seen = ~np.isnan(errors)
        samples = resampled.quantile(errors, seen, 0.5)
        medians.append(samples)
        found.append(_standing(name, own, errors, seen, samples, resampled, quantity))
    ranks = _ranks(np.array(medians))
    placed = [
        standing._replace(rank=_figure(own)) for standing, own in zip(found, ranks, strict=True)
    ]
    return sorted(placed, key=lambda standing: standing.rank.value)


def _standing(
    name: str,
    images: Sequence[Judged],
    errors: np.ndarray,
    seen: np.ndarray,
    medians: np.ndarray,
    resampled: _Resampled,
    quantity: str,
) -> Standing:
    counts = counts_of(images)
    is_found = np.isfinite(errors)
    # Outside of the images that count, errors are NaN or infinite; the weights remove them.
    known = np.where(is_found, errors, 0.0)
    sigmas = np.array([image.sigmas.get(quantity, math.nan) for image in images])
    stated = is_found & (sigmas > 0) & np.isfinite(sigmas)
    false = np.array([i.outcome in (Outcome.MISPLACED, Outcome.INVENTED) for i in images])
    part = np.divide(known, sigmas, out=np.full(known.shape, math.inf), where=stated)
    ratio = errors / (_MEDIAN_OF_NORMAL * np.array([_bound(image, quantity) for image in images]))
    return Standing(
        entry=name,
        rank=Figure(),
        visible=counts.visible,
        missed=_figure(resampled.mean(~is_found, seen)),
        false_spots=_figure(resampled.mean(false, np.ones_like(seen))),
        median=_figure(medians),
        ninth=_figure(resampled.quantile(errors, seen, 0.9)),
        rmse=_figure(np.sqrt(resampled.mean(known**2, is_found))),
        within_1=_figure(resampled.mean(part <= 1, stated)),
        within_196=_figure(resampled.mean(part <= _WIDE, stated)),
        over_bound=_figure(resampled.quantile(ratio, seen & ~np.isnan(ratio), 0.5)),
    )


def _absolute_error(image: Judged, quantity: str) -> float:
    """Infinite for a missed image, NaN for a hidden one."""
    if image.outcome is Outcome.FOUND:
        error = abs(image.errors[quantity])
        return math.inf if math.isnan(error) else error
    return math.inf if image.outcome in (Outcome.MISSED, Outcome.MISPLACED) else math.nan


def _bound(image: Judged, quantity: str) -> float:
    name = _BOUNDS.get(quantity)
    return getattr(image.circumstances.labels, name) if name else math.nan


class _Resampled:
    """The images as they are, and with stacks drawn with replacement, the same for all entries.

    Images of a stack show the same wall and motion, so their errors are not independent.
    """

    def __init__(self, stacks: Sequence[str]) -> None:
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


def _figure(samples: np.ndarray) -> Figure:
    """A figure from its value on all images and on the resamples."""
    drawn = samples[1:][~np.isnan(samples[1:])]
    if not drawn.size:
        return Figure(float(samples[0]))
    # No interpolation: a part of the resamples may be infinite.
    low, high = np.quantile(drawn, (0.025, 0.975), method="inverted_cdf")
    return Figure(float(samples[0]), float(low), float(high))


def _ranks(medians: np.ndarray) -> np.ndarray:
    """Rank of each entry (rows) in each resample (columns): 1 + the number of better entries."""
    better = medians[None, :, :] < medians[:, None, :]
    ranks: np.ndarray = 1.0 + better.sum(axis=1)
    return ranks
