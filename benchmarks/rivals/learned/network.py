"""The network: from a window and its place to an ellipse and a distance, each with its sigma."""

from __future__ import annotations

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from benchmarks.rivals.learned.crops import NUMBERS, PLACES

Numbers = Array | np.ndarray

_CHANNELS = ((3, 16, 5, 2), (16, 24, 3, 1), (24, 32, 3, 2), (32, 48, 3, 2), (48, 64, 3, 2))
"""(channels in, channels out, width, stride) of each convolution: 64 cells become 4."""

_SEEN = 4 * 4 * _CHANNELS[-1][1]
_WIDTH = 96
_SCALES = (0.1, 0.1, 0.1, 0.1, 0.1, 1.0)
"""Of the numbers: their orders of magnitude. Steps of the optimiser are of the order of 1."""

_LEAST_LOG, _MOST_LOG = -9.0, 2.0  # of sigma: outside of it nothing is learnt


class Output(NamedTuple):
    """What the network says about a window.

    Attributes:
        mean: the six numbers of `targets.NUMBERS`.
        log_sigma: logarithms of their standard deviations.
        presence: logit of "a spot is in the window, and half of its contour is visible".
    """

    mean: Float[Array, "*batch 6"]
    log_sigma: Float[Array, "*batch 6"]
    presence: Float[Array, "*batch"]


class SpotNetwork(eqx.Module):
    """Five convolutions and two dense layers; the distance has a branch that knows the place.

    The errors are normal with a standard deviation of their own in each window, which the network
    gives, too (Nix and Weigend 1994).
    """

    convolutions: tuple[eqx.nn.Conv2d, ...]
    norms: tuple[eqx.nn.GroupNorm, ...]
    dense: eqx.nn.Linear
    ellipse: eqx.nn.Linear
    with_place: eqx.nn.Linear
    distance: eqx.nn.Linear

    def __init__(self, *, key: PRNGKeyArray) -> None:
        keys = iter(jax.random.split(key, len(_CHANNELS) + 4))
        self.convolutions = tuple(
            eqx.nn.Conv2d(n, m, width, stride=stride, padding=width // 2, key=next(keys))
            for n, m, width, stride in _CHANNELS
        )
        self.norms = tuple(eqx.nn.GroupNorm(4, m) for _, m, _, _ in _CHANNELS)
        self.dense = eqx.nn.Linear(_SEEN, _WIDTH, key=next(keys))
        self.ellipse = eqx.nn.Linear(_WIDTH, 11, key=next(keys))
        self.with_place = eqx.nn.Linear(_WIDTH + PLACES, _WIDTH // 2, key=next(keys))
        self.distance = eqx.nn.Linear(_WIDTH // 2, 2, key=next(keys))

    def __call__(self, window: Float[Numbers, "3 64 64"], place: Float[Numbers, "4"]) -> Output:
        """What the network says about one window (`crops.evened`) at a place."""
        seen = jnp.asarray(window)
        for convolution, norm in zip(self.convolutions, self.norms, strict=True):
            seen = jax.nn.relu(norm(convolution(seen)))
        features = jax.nn.relu(self.dense(seen.reshape(-1)))
        ellipse = self.ellipse(features)
        placed = jax.nn.relu(self.with_place(jnp.concatenate([features, place])))
        distance = self.distance(placed)
        log_sigma = jnp.concatenate([ellipse[5:10], distance[1:]])
        return Output(
            jnp.concatenate([ellipse[:5], distance[:1]]) * jnp.asarray(_SCALES, seen.dtype),
            jnp.clip(log_sigma, _LEAST_LOG, _MOST_LOG),
            ellipse[10],
        )


def loss(
    network: SpotNetwork,
    windows: Float[Numbers, "n 3 64 64"],
    places: Float[Numbers, "n 4"],
    targets: Float[Numbers, "n 6"],
    present: Float[Numbers, " n"],
) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """Mean loss of some windows, and the part of it that can be compared between epochs.

    The loss is the negative logarithm of the normal density where a spot is present. Each summand
    is weighed by its sigma (not differentiated), without which hard windows are hardly learnt: beta
    = 0.5 in Seitzer et al. (2022). Presence has the cross entropy. The second result is the same
    without the weights, which change from epoch to epoch.
    """
    said = jax.vmap(network)(windows, places)
    z = (targets - said.mean) * jnp.exp(-said.log_sigma)
    summands = jnp.square(z) / 2 + said.log_sigma
    weights = jax.lax.stop_gradient(jnp.exp(said.log_sigma)) * len(NUMBERS)
    entropy = jnp.mean(jax.nn.softplus(said.presence) - present * said.presence)

    def over_spots(values: Float[Array, "n 6"]) -> Float[Array, ""]:
        return jnp.sum(present * jnp.sum(values, axis=1)) / jnp.maximum(jnp.sum(present), 1.0)

    return over_spots(weights * summands) + entropy, over_spots(summands) + entropy
