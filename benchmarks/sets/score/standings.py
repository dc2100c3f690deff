"""Standings of estimators on the same images, with intervals by a bootstrap over stacks."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd

from benchmarks.sets.score.images import ALL, CONDITIONS, groups
from benchmarks.sets.score.judging import Outcome, counts_of
from optics import InputError

_RESAMPLED = 1000  # the ends of a 95 % interval vary by 3 % of its width
_FEWEST_STACKS = 3  # fewer are not enough for a bootstrap
_MEDIAN_OF_NORMAL = 0.6745  # of the absolute value, in sigmas
_BOUNDS = {"semi_minor_px": "bound_semi_minor_px", "distance_mm": "bound_d_mm"}
"""Label with the bound of a quantity."""
_WIDE = 1.96  # sigmas that contain 95 % of normal errors


def standings(judged: Mapping[str, pd.DataFrame], quantity: str) -> pd.DataFrame:
    """Rank the entries that measure a quantity, on the images that all of them cover.

    A figure has the ends of its 95 % interval beside it, such as `median_low` and `median_high`;
    NaN if unknown. By `condition` and `group`, in the order of the ranks:

    - `rank`: 1 has the least median error; of equal medians all have the lower rank.
    - `visible`: number of images in which half of the contour or more is visible; `missed`:
      fraction of them without the true spot; `false_spots`: spots at a wrong place, per image.
    - `median` and `ninth_decile` of the absolute error over the visible images. The error of a
      missed image counts as infinite, so that leaving difficult images out does not help.
    - `rmse` of the found images; `within_1_sigma` and `within_196_sigma`: fraction of the errors
      within the stated σ, 0.683 and 0.950 if σ is right.
    - `over_bound`: median of the absolute error divided by the image's Cramér-Rao bound, as a
      multiple of the median of a normal error of that size: 1 cannot be beaten without bias.

    Args:
        judged: images of each entry, see `judge`.
        quantity: one of `QUANTITIES`.

    Returns:
        Standings on all images, and by condition; conditions with one group are left out. Empty if
        no entry measures the quantity. An entry that finds no spot is the last on the ellipse.

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


def _standing(own: pd.DataFrame, resampled: _Resampled, quantity: str) -> dict[str, np.ndarray]:
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
