"""Compares a recording with a plan: hits, misses, and what explains the misses."""

from __future__ import annotations

import math
from collections import Counter
from typing import NamedTuple

import numpy as np

from benchmarks.predictions.observing import Observed
from benchmarks.predictions.plan import ELLIPSE, QUANTITIES, Plan
from optics import InputError

SURE = 3.0
"""Standard deviations from which a value counts as another one: 1 in 400 by chance."""

_WIDE = 1e6  # of a key that is fitted freely, in its standard uncertainties
_WITHIN = 1.959964


class Tally(NamedTuple):
    """Predictions of one quantity.

    Attributes:
        quantity: one of `QUANTITIES`.
        hits: that lie in their interval.
        misses: that do not, or for which there is nothing measured.
        unmeasured: of these, those without a measurement.
        rms: of measured minus predicted, over the standard uncertainty.
    """

    quantity: str
    hits: int
    misses: int
    unmeasured: int
    rms: float


class Cause(NamedTuple):
    """What the recording says about an uncertain key of the scene.

    Attributes:
        stated: its value in the plan.
        found: the value with which the recording agrees best.
        pull: found minus stated, over the standard deviation of that difference.
    """

    key: str
    stated: float
    stated_sigma: float
    found: float
    found_sigma: float
    pull: float

    @property
    def contradicts(self) -> bool:
        """Whether the recording contradicts what was stated."""
        return abs(self.pull) > SURE


class Judgement(NamedTuple):
    """Which predictions held.

    Attributes:
        causes: of every uncertain key, the farthest first.
        misfit: of what remains with the best values of all keys, over the noise, RMS.
        no_spot: frames without a spot, by reason.
    """

    tallies: list[Tally]
    causes: list[Cause]
    misfit: float
    no_spot: Counter[str]

    @property
    def hits(self) -> int:
        """Predictions that held."""
        return sum(tally.hits for tally in self.tallies)

    @property
    def predictions(self) -> int:
        """Predictions in all."""
        return sum(tally.hits + tally.misses for tally in self.tallies)


def judged(plan: Plan, seen: Observed) -> Judgement:
    """Compare a recording with a plan.

    Args:
        seen: the recording, on the plan's clock.

    Raises:
        InputError: no frame was taken at a time that the plan has.
    """
    expected, noise, moved = _at(plan, seen.times_s)
    if np.isnan(expected).all():
        raise InputError(
            f"no frame has a time from {plan.times_s[0]:g} to {plan.times_s[-1]:g} s, for which the"
            " plan has predictions. --begin says when the motion begins."
        )
    sigma = np.sqrt(noise**2 + np.sum(moved**2, axis=0))
    pulls = (seen.values - expected) / sigma
    tallies = [
        _tally(name, pull, wanted)
        for name, pull, wanted in zip(QUANTITIES, pulls.T, expected.T, strict=True)
        # No poses, no prediction about them; but a spot that is not there is a miss.
        if not np.isnan(wanted).all() and not (name == "robot_mm" and np.isnan(pull).all())
    ]
    causes, misfit = _explained(plan, (seen.values - expected) / noise, moved / noise)
    return Judgement(tallies, causes, misfit, seen.no_spot)


def _tally(name: str, pulls: np.ndarray, expected: np.ndarray) -> Tally:
    predicted = ~np.isnan(expected)
    hits = int(np.sum(np.abs(pulls) <= _WITHIN))
    measured = pulls[~np.isnan(pulls)]
    return Tally(
        name,
        hits=hits,
        misses=int(predicted.sum()) - hits,
        unmeasured=int(np.sum(np.isnan(pulls) & predicted)),
        rms=float(np.sqrt(np.mean(measured**2))) if measured.size else math.nan,
    )


def _at(plan: Plan, times: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Expected values, noise, and what moves them, at the times of frames; NaN outside."""
    # A frame that is jittered beyond the plan's ends is still its first or last.
    step = float(np.median(np.diff(plan.times_s))) if len(plan.times_s) > 1 else math.inf
    low, high = plan.times_s[0], plan.times_s[-1]
    inside = (times >= low - step / 2) & (times <= high + step / 2)

    def columns(table: np.ndarray) -> np.ndarray:
        found = [np.interp(times, plan.times_s, column) for column in table.T]
        return np.where(inside[:, None], np.array(found).T, np.nan)

    moved = [columns(table) for table in plan.moved]
    shape = (len(moved), len(times), len(QUANTITIES))
    return columns(plan.expected), columns(plan.noise), np.array(moved).reshape(shape)


def _explained(plan: Plan, residual: np.ndarray, moved: np.ndarray) -> tuple[list[Cause], float]:
    """Each key fitted freely while the others keep to what is stated; and what then remains.

    The least-squares fit of all keys, each in its standard uncertainties and with a prior of one of
    them; the key in question has none. The distance follows from the ellipse and does not count
    again.
    """
    counted = np.ones(len(QUANTITIES), bool)
    counted[ELLIPSE] = False
    used = ~np.isnan(residual) & ~np.isnan(moved).any(axis=0) & counted
    data = residual[used]
    design = np.array([table[used] for table in moved]).reshape(len(moved), data.size).T
    keys = list(plan.uncertain)
    best = _fit(design, data, np.ones(len(keys)))[0]
    misfit = float(np.sqrt(np.mean((data - design @ best) ** 2))) if data.size else math.nan
    # What no key explains is noise for them all (Birge 1932).
    scale = max(1.0, misfit)
    causes = []
    for index, key in enumerate(keys):
        prior = np.ones(len(keys))
        prior[index] = 1 / _WIDE
        found, covariance = _fit(design / scale, data / scale, prior)
        error = math.sqrt(covariance[index, index])
        stated, unit = plan.uncertain[key]
        causes.append(
            Cause(
                key,
                stated,
                unit,
                stated + unit * float(found[index]),
                unit * error,
                float(found[index]) / math.hypot(1.0, error),
            )
        )
    return sorted(causes, key=lambda cause: -abs(cause.pull)), misfit


def _fit(design: np.ndarray, data: np.ndarray, prior: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Least squares with a prior of 0 and weights `prior`; the estimate and its covariance."""
    normal = design.T @ design + np.diag(prior**2)
    covariance = np.linalg.inv(normal)
    return covariance @ (design.T @ data), covariance
