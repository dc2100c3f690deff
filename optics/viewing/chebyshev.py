"""Chebyshev series: coefficients from values, and values with slopes."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, ScalarLike


def chebyshev_nodes(terms: int) -> tuple[Float[Array, "n"], Float[Array, "n n"]]:
    """Chebyshev's nodes, and the matrix from values there to coefficients (Trefethen 2013)."""
    angles = np.pi * (np.arange(terms) + 0.5) / terms
    matrix = 2.0 / terms * np.cos(np.outer(np.arange(terms), angles))
    matrix[0] /= 2.0
    return jnp.asarray(np.cos(angles)), jnp.asarray(matrix)


def series(terms: Float[Array, "terms"], place: ScalarLike) -> Float[Array, "*batch"]:
    """A Chebyshev series at places in [-1, 1]."""
    return series_and_slope(list(terms), jnp.asarray(place, float))[0]


def series_and_slope(
    terms: list[Float[Array, "*batch"]], place: Float[Array, "*batch"]
) -> tuple[Float[Array, "*batch"], Float[Array, "*batch"]]:
    """A Chebyshev series and its derivative by Clenshaw's recurrence."""
    after, last = jnp.zeros_like(place), jnp.zeros_like(place)
    slope_after, slope_last = after, last
    for term in reversed(terms[1:]):
        slope_after, slope_last = slope_last, 2.0 * (last + place * slope_last) - slope_after
        after, last = last, term + 2.0 * place * last - after
    return terms[0] + place * last - after, last + place * slope_last - slope_after
