"""How far a contour's fitted ellipse is from a measured one, without fitting it.

Fitting ellipses inside a solver is slow. But whether a given ellipse is the fitted one shows in the
fit's normal equations alone.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from optics.ellipse import Ellipse, in_unit_circle, steps_of_eccentric_angle

_LEAST_SINE = 0.25
"""Least variance of the term of sin 2t over that of cos 2t. Noise that is alike all round a circle
makes the two equal."""


def ellipse_mismatch(contour: Float[Array, "n 2"], ellipse: Ellipse) -> Float[Array, "5"]:
    """How a contour's fitted ellipse differs from a given one; zero where it is the given one.

    In the coordinates (p, q) in which the given ellipse is the unit circle: shift along p and q,
    and the terms of 1, cos 2t and sin 2t in the radius. To first order; the zero is exact, for
    there the conic 1 - p^2 - q^2 fulfils the normal equations of the fit, whose test functions
    about the centroid these are.

    Args:
        contour: in order round the curve, px; 32 points leave 1e-7 px.
        ellipse: the given one, px.

    Returns:
        Five numbers, relative to the ellipse's axes.
    """
    # Without the barrier XLA computes the contour anew for each of its points: 3 ms, not 0.7.
    contour = jax.lax.optimization_barrier(contour)
    p, q = in_unit_circle(contour, ellipse)
    weights = steps_of_eccentric_angle(contour, ellipse)
    p, q, weights = jax.lax.optimization_barrier((p, q, weights))
    weights /= jnp.sum(weights)
    x, y = p - jnp.sum(weights * p), q - jnp.sum(weights * q)
    outside = weights * (p * p + q * q - 1.0)
    return jnp.stack(
        [
            jnp.sum(outside * x),
            jnp.sum(outside * y),
            0.5 * jnp.sum(outside * (x * x + y * y)),
            jnp.sum(outside * (x * x - y * y)),
            2.0 * jnp.sum(outside * x * y),
        ]
    )


def mismatch_covariance(ellipse: Ellipse, covariance: Float[Array, "5 5"]) -> Float[Array, "5 5"]:
    """Covariance of `ellipse_mismatch`'s terms.

    Args:
        ellipse: measured, px.
        covariance: of (centre u, centre v, semi-major, semi-minor in px; angle in rad).
    """
    a, b = ellipse.semi_major, ellipse.semi_minor
    c, s = jnp.cos(ellipse.angle), jnp.sin(ellipse.angle)
    zero = jnp.zeros(())
    jacobian = jnp.array(
        [
            [c / a, s / a, zero, zero, zero],
            [-s / b, c / b, zero, zero, zero],
            [zero, zero, 0.5 / a, 0.5 / b, zero],
            [zero, zero, 0.5 / a, -0.5 / b, zero],
            [zero, zero, zero, zero, 0.5 * (a / b - b / a)],
        ]
    )
    relative = jacobian @ covariance @ jacobian.T
    # A circle's angle says nothing of sin 2t, which noise moves about as much as cos 2t.
    sine = jnp.maximum(relative[4, 4], _LEAST_SINE * relative[3, 3])
    return relative.at[4, 4].set(sine)
