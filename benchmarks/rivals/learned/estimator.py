"""The trained network as an estimator: frame in, ellipse and distance with their sigmas out."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx
import jax
import numpy as np

from benchmarks.rivals.learned.crops import (
    Guess,
    Window,
    blob_in,
    covariance_of,
    cut,
    ellipse_of,
    evened,
    place_of,
)
from benchmarks.rivals.learned.network import SpotNetwork
from estimator import MicroscopeFile
from optics import InputError, in_file, read_text

WEIGHTS = Path(__file__).with_name("weights.eqx")
"""The weights that come with eyespot; what they were made of is beside them, in weights.json."""

SCALED = ("x", "y", "semi_major", "semi_minor", "distance")
"""Quantities whose sigmas have a factor from the split `validation`."""

_PASSES = 2  # the first window is the blob's, the second the first ellipse's


@dataclass(frozen=True, kw_only=True)
class Trust:
    """What the split `validation` says about the network's own words.

    Attributes:
        factors: by which the sigmas of `SCALED` are multiplied.
        least_presence: logit below which a window counts as empty.
    """

    factors: Mapping[str, float]
    least_presence: float


UNJUDGED = Trust(factors=dict.fromkeys(SCALED, 1.0), least_presence=-math.inf)
"""Takes the network at its word."""


class Learned(NamedTuple):
    """What the estimator says about a frame; lengths px and mm.

    Attributes:
        ellipse: x, y, semi-major, semi-minor, angle.
        covariance: 5 x 5.
        distance_mm: tip to wall along the beam.
        presence: logit of a spot in the last window.
    """

    ellipse: np.ndarray
    covariance: np.ndarray
    distance_mm: float
    sigma_distance_mm: float
    presence: float


class LearnedEstimator:
    """Finds the spot with a blob, then twice with the network.

    It knows the light sources of the set that it was trained on, and no others: its distances are
    theirs.

    Args:
        trust: from the split `validation`.
    """

    def __init__(self, network: SpotNetwork, trust: Trust = UNJUDGED) -> None:
        self._network = network
        self._trust = trust

    @classmethod
    def load(cls, weights: Path = WEIGHTS) -> LearnedEstimator:
        """The estimator of a file of weights and the JSON file of the same name beside it.

        Raises:
            InputError: a file is missing or is not what `eyespot rivals train` wrote.
        """
        about = weights.with_suffix(".json")
        with in_file(about):
            try:
                trust = json.loads(read_text(about))["trust"]
                known = Trust(
                    factors={name: float(trust["factors"][name]) for name in SCALED},
                    least_presence=float(trust["least_presence"]),
                )
            except (OSError, ValueError, KeyError, TypeError) as error:
                raise InputError(f"cannot be read: {error}. Train again.") from error
        return cls(load_network(weights), known)

    def measure(self, image: np.ndarray, microscope: MicroscopeFile) -> Learned | None:
        """Measure an 8-bit frame; None if no spot is seen in it."""
        guess = blob_in(image)
        said: Learned | None = None
        for _ in range(_PASSES):
            if guess is None:
                return None
            said = self._said(image, guess, microscope)
            x, y, a, b, _ = said.ellipse
            inside = 0 <= x < image.shape[1] and 0 <= y < image.shape[0]
            guess = Guess(x, y, math.sqrt(a * b)) if inside else None
        unseen = guess is None or said is None or said.presence < self._trust.least_presence
        return None if unseen else said

    def _said(self, image: np.ndarray, guess: Guess, microscope: MicroscopeFile) -> Learned:
        window = Window.around(guess)
        seen = evened(cut(image, window)).astype(np.float32)
        place = place_of(window, microscope).astype(np.float32)
        mean, log_sigma, presence = map(np.asarray, _forward(self._network, seen, place))
        numbers, sigmas = mean.astype(float), np.exp(log_sigma.astype(float))
        factors = self._trust.factors
        each = np.array([factors[name] for name in SCALED[:4]] + [1.0])
        distance = math.exp(numbers[5])
        return Learned(
            ellipse=ellipse_of(numbers, window),
            covariance=covariance_of(numbers, sigmas, window) * np.outer(each, each),
            distance_mm=distance,
            sigma_distance_mm=distance * float(sigmas[5]) * factors["distance"],
            presence=float(presence),
        )


def load_network(weights: Path) -> SpotNetwork:
    """The network of a file of weights.

    Raises:
        InputError: it is missing or not a file of this network's weights.
    """
    with jax.enable_x64(False):
        like = eqx.filter_eval_shape(SpotNetwork, key=jax.random.key(0))
    with in_file(weights):
        try:
            return eqx.tree_deserialise_leaves(weights, like)
        except (OSError, RuntimeError, ValueError, EOFError) as error:
            raise InputError(f"not weights of this network ({error}). Train again.") from error


@eqx.filter_jit
def _forward(network: SpotNetwork, seen: Any, place: Any) -> Any:
    return tuple(network(seen, place))
