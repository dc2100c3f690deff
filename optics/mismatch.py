"""Difference of a contour's ellipse from a measured one, without a fit.

Fitting ellipses inside a solver is slow. The fit's normal equations are enough to test whether a
given ellipse is the fitted one.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from optics.ellipse import Ellipse, in_unit_circle, steps_of_eccentric_angle

_LEAST_SINE = 0.25
"""Least variance of the sin 2t term over that of the cos 2t term. For uniform noise around a
circle the two are equal."""


def ellipse_mismatch(contour: Float[Array, "n 2"], ellipse: Ellipse) -> Float[Array, "5"]:
    """Difference of a contour's fitted ellipse from a given one, to first order.

    In coordinates (p, q) in which the given ellipse is the unit circle: shift along p and q, and
    the terms of 1, cos 2t and sin 2t in the radius. They are exactly zero if the two ellipses are
    equal, because then the conic 1 - p^2 - q^2 satisfies the normal equations of the fit. Without
    the division by the contour's mean square radius, they would also vanish for a contour of size
    0, and a solver with many unknowns goes there.

    Args:
        contour: points in order around the curve, px; with 32 points the error is 1e-7 px.
        ellipse: the given ellipse, px.

    Returns:
        Five numbers, relative to the ellipse's axes.
    """
    # Without the barrier XLA computes the contour again for each of its points: 3 ms, not 0.7.
    contour = jax.lax.optimization_barrier(contour)
    p, q = in_unit_circle(contour, ellipse)
    weights = steps_of_eccentric_angle(contour, ellipse)
    p, q, weights = jax.lax.optimization_barrier((p, q, weights))
    weights /= jnp.sum(weights)
    x, y = p - jnp.sum(weights * p), q - jnp.sum(weights * q)
    outside = weights * (p * p + q * q - 1.0) / jnp.sum(weights * (x * x + y * y))
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
        covariance: covariance of (centre u, centre v, semi-major, semi-minor in px; angle in rad).
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
    # A circle's angle has no effect on sin 2t, but noise changes it about as much as cos 2t.
    sine = jnp.maximum(relative[4, 4], _LEAST_SINE * relative[3, 3])
    return relative.at[4, 4].set(sine)
