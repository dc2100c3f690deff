"""The ellipse of a contour, with one definition for labels, models and fits."""

import itertools
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

_REWEIGHTINGS = 2
_CENTRAL_DIFFERENCE = (4 / 5, -1 / 5, 4 / 105, -1 / 280)
"""Eighth order (Fornberg 1988); second order would have an error of 4e-5 px at 128 points."""
_CONIC_POWERS = ((2, 0), (1, 1), (0, 2), (1, 0), (0, 1))
"""Powers of x and y in A x^2 + B xy + C y^2 + D x + E y = 1."""


class Ellipse(NamedTuple):
    """Ellipse in an image (px) or on a plane (mm).

    Attributes:
        centre: (u, v).
        semi_major: half of the longer axis.
        semi_minor: half of the shorter axis.
        angle: angle of the semi-major axis from +u towards +v, rad, in (-pi/2, pi/2].
    """

    centre: Float[Array, "*batch 2"]
    semi_major: Float[Array, "*batch"]
    semi_minor: Float[Array, "*batch"]
    angle: Float[Array, "*batch"]


def ellipse_of_contour(contour: Float[Array, "*batch n 2"]) -> Ellipse:
    r"""Ellipse of a closed contour: algebraic least squares, uniform in the ellipse's own angle.

    The conic $A x^2 + B xy + C y^2 + D x + E y = 1$ around the centroid minimises the unweighted
    sum of squared residuals over points that are uniform in the ellipse's eccentric angle t. The
    contour has equal steps of another parameter (the generator's angle), so the weight of each
    point is its step dt. This is the trapezoid rule of the same integral, which converges faster
    than any power of n on a smooth periodic curve. t depends on the ellipse, so a first fit uses
    uniform weights and two more refine them.

    Args:
        contour: points in order around the curve; n of 32 or more.

    Returns:
        The ellipse; exact (to rounding) if the contour is one.
    """

    def refit(_: int, ellipse: Ellipse) -> Ellipse:
        return _fit(contour, steps_of_eccentric_angle(contour, ellipse))

    # Unrolled, the loop would take seconds to compile wherever it is used.
    even = _fit(contour, jnp.ones(contour.shape[:-1]))
    return jax.lax.fori_loop(0, _REWEIGHTINGS, refit, even)


def ellipse_points(ellipse: Ellipse, angles: Float[Array, "n"]) -> Float[Array, "*batch n 2"]:
    """Points of an ellipse at eccentric angles (rad)."""
    cos_t = ellipse.semi_major[..., None] * jnp.cos(angles)
    sin_t = ellipse.semi_minor[..., None] * jnp.sin(angles)
    c, s = jnp.cos(ellipse.angle)[..., None], jnp.sin(ellipse.angle)[..., None]
    around = jnp.stack([c * cos_t - s * sin_t, s * cos_t + c * sin_t], axis=-1)
    return ellipse.centre[..., None, :] + around


def in_unit_circle(
    points: Float[Array, "*batch n 2"], ellipse: Ellipse
) -> tuple[Float[Array, "*batch n"], Float[Array, "*batch n"]]:
    """Points in coordinates along the ellipse's axes, scaled so that it is the unit circle."""
    c, s = jnp.cos(ellipse.angle)[..., None], jnp.sin(ellipse.angle)[..., None]
    x = points[..., 0] - ellipse.centre[..., 0, None]
    y = points[..., 1] - ellipse.centre[..., 1, None]
    p = (c * x + s * y) / ellipse.semi_major[..., None]
    q = (c * y - s * x) / ellipse.semi_minor[..., None]
    return p, q


def steps_of_eccentric_angle(
    contour: Float[Array, "*batch n 2"], ellipse: Ellipse
) -> Float[Array, "*batch n"]:
    """Change of the ellipse's eccentric angle in one step along the contour, at each point."""
    p, q = in_unit_circle(contour, ellipse)
    dp, dq = _per_step(p), _per_step(q)
    return jnp.abs(p * dq - q * dp) / (p * p + q * q)


def _per_step(periodic: Float[Array, "*batch n"]) -> Float[Array, "*batch n"]:
    """Derivative of a periodic sequence by its index, of eighth order."""
    derivative = jnp.zeros_like(periodic)
    for step, weight in enumerate(_CENTRAL_DIFFERENCE, 1):
        ahead, behind = jnp.roll(periodic, -step, axis=-1), jnp.roll(periodic, step, axis=-1)
        derivative += weight * (ahead - behind)
    return derivative


def _fit(contour: Float[Array, "*batch n 2"], weights: Float[Array, "*batch n"]) -> Ellipse:
    """Weighted algebraic least squares around the centroid, from moments up to fourth order."""
    total = jnp.sum(weights, axis=-1)
    u, v = contour[..., 0], contour[..., 1]
    u0, v0 = jnp.sum(u * weights, axis=-1) / total, jnp.sum(v * weights, axis=-1) / total
    x, y = u - u0[..., None], v - v0[..., None]
    moments = {
        (i, j): jnp.sum(weights * x**i * y**j, axis=-1)
        for i, j in itertools.product(range(5), repeat=2)
        if 0 < i + j <= 4
    }
    size = jnp.sqrt((moments[2, 0] + moments[0, 2]) / total)
    moments = {(i, j): moment / size ** (i + j) for (i, j), moment in moments.items()}
    normal = [
        [moments[i + k, j + m] for k, m in _CONIC_POWERS[: row + 1]]
        for row, (i, j) in enumerate(_CONIC_POWERS)
    ]
    a, b, c, d, e = _solved(normal, [moments[powers] for powers in _CONIC_POWERS])
    determinant = 4.0 * a * c - b * b
    x0 = (b * e - 2.0 * c * d) / determinant
    y0 = (b * d - 2.0 * a * e) / determinant
    level = 1.0 + a * x0 * x0 + b * x0 * y0 + c * y0 * y0
    mean, half_difference = 0.5 * (a + c), 0.5 * (a - c)
    circular = (half_difference == 0) & (b == 0)
    # A circle has no direction; the inner `where`s keep the derivatives finite.
    safe = jnp.where(circular, 1.0, half_difference)
    spread = jnp.where(circular, 0.0, jnp.sqrt(safe**2 + 0.25 * b * b))
    angle = 0.5 * jnp.arctan2(-0.5 * b, -safe)
    # (-pi/2, pi/2]: the major axis along v is +pi/2, whatever the sign of a zero.
    angle = jnp.where(angle <= -0.5 * jnp.pi, 0.5 * jnp.pi, angle)
    return Ellipse(
        centre=jnp.stack([u0 + size * x0, v0 + size * y0], axis=-1),
        semi_major=size * jnp.sqrt(level / (mean - spread)),
        semi_minor=size * jnp.sqrt(level / (mean + spread)),
        angle=jnp.where(circular, 0.0, angle),
    )


def _solved(
    lower: list[list[Float[Array, "*batch"]]], target: list[Float[Array, "*batch"]]
) -> list[Float[Array, "*batch"]]:
    """Solution of a small positive definite system, given by its lower triangle, unrolled.

    A batched LAPACK call costs about 2 us a system on a CPU; unrolled, the arithmetic is
    vectorised over the batch and costs a twentieth of it.
    """
    factor: list[list[Float[Array, "*batch"]]] = []
    for given in (*lower, target):  # with the target below, its row solves the lower triangle
        row: list[Float[Array, "*batch"]] = []
        for j, value in enumerate(given):
            above = factor[j] if j < len(factor) else row
            for left, right in zip(row, above, strict=False):
                value = value - left * right
            row.append(value / above[j] if j < len(factor) else jnp.sqrt(value))
        factor.append(row)
    *factor, solution = factor
    for i in reversed(range(len(target))):
        for k in range(i + 1, len(target)):
            solution[i] = solution[i] - factor[k][i] * solution[k]
        solution[i] = solution[i] / factor[i][i]
    return solution
