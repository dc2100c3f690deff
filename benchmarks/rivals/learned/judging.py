"""How far the network's own words can be trusted, from the split `validation` alone."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from benchmarks.evaluation import VISIBLE_ENOUGH
from benchmarks.rivals.learned.estimator import SCALED, Learned, LearnedEstimator, Trust
from benchmarks.rivals.learned.network import SpotNetwork
from benchmarks.sets.read import SetStack
from estimator import FrameLabels, read_microscope

_SHARE = 0.683  # of the errors within one sigma
_REFUSED = 0.01  # part of the visible spots that may be refused


class Judgement(NamedTuple):
    """What was measured on the split `validation`.

    Attributes:
        trust: the factors of the sigmas, and the least presence.
        frames: number of frames with a visible spot.
        rms: root mean square errors of `SCALED`, px and mm.
        within_2: part of the errors within two sigmas, after the factors.
    """

    trust: Trust
    frames: int
    rms: dict[str, float]
    within_2: dict[str, float]


def judged(network: SpotNetwork, stacks: Sequence[SetStack]) -> Judgement:
    """Measure all frames, and choose factors with which 68.3 % of the errors lie within a sigma."""
    estimator = LearnedEstimator(network)
    errors, sigmas, presences = [], [], []
    for entry in stacks:
        microscope = read_microscope(entry.folder / "microscope.json")
        stack = entry.open()
        for labels in stack.labels:
            if labels.visible_fraction < VISIBLE_ENOUGH:
                continue
            said = estimator.measure(stack.image(labels), microscope)
            presences.append(-np.inf if said is None else said.presence)
            if said is not None and _is_found(said, labels):
                errors.append(_errors(said, labels))
                variances = np.diag(said.covariance)[:4]
                sigmas.append([*np.sqrt(variances), said.sigma_distance_mm])
    z = np.abs(errors) / np.array(sigmas)
    factors = np.quantile(z, _SHARE, axis=0)
    trust = Trust(
        factors=dict(zip(SCALED, factors.tolist(), strict=True)),
        least_presence=float(np.quantile(presences, _REFUSED)),
    )
    rms, within = np.sqrt(np.mean(np.square(errors), axis=0)), np.mean(z < 2 * factors, axis=0)
    return Judgement(
        trust,
        len(presences),
        dict(zip(SCALED, rms.tolist(), strict=True)),
        dict(zip(SCALED, within.tolist(), strict=True)),
    )


def _is_found(said: Learned, labels: FrameLabels) -> bool:
    off = np.hypot(said.ellipse[0] - labels.half_max_x_px, said.ellipse[1] - labels.half_max_y_px)
    return bool(off <= labels.half_max_semi_major_px)


def _errors(said: Learned, labels: FrameLabels) -> list[float]:
    truth = (
        labels.half_max_x_px,
        labels.half_max_y_px,
        labels.half_max_semi_major_px,
        labels.half_max_semi_minor_px,
    )
    return [*(said.ellipse[:4] - truth), said.distance_mm - labels.d_mm]
