"""The ellipse of a contour, with one definition for labels, models and fits.

As in `lines`, arrays may be NumPy's or JAX's, and JAX is not imported for NumPy's.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from eyespot.optics.lines import array_namespace

if TYPE_CHECKING:
    from jaxtyping import Float

    Array = Any  # NumPy's or JAX's

_CENTRAL_DIFFERENCE = (4 / 5, -1 / 5, 4 / 105, -1 / 280)
"""Eighth order (Fornberg 1988); second order would have an error of 4e-5 px at 128 points."""


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

    def size(self, *, by_area: bool) -> Float[Array, "*batch"]:
        """Radius of the circle with the ellipse's area, or the semi-minor axis."""
        if not by_area:
            return self.semi_minor
        return array_namespace(self.semi_minor).sqrt(self.semi_major * self.semi_minor)


def ellipse_of_contour(contour: Float[Array, "*batch n 2"], *, reweightings: int = 2) -> Ellipse:
    r"""Ellipse of a closed contour: algebraic least squares, uniform in the ellipse's own angle.

    The conic $A x^2 + B xy + C y^2 + D x + E y = 1$ around the centroid minimises the unweighted
    sum of squared residuals over points that are uniform in the ellipse's eccentric angle t. The
    contour has equal steps of another parameter (the generator's angle), so the weight of each
    point is its step dt. This is the trapezoid rule of the same integral, which converges faster
    than any power of n on a smooth periodic curve. t depends on the ellipse, so a first fit uses
    uniform weights and others refine them.

    Args:
        contour: points in order around the curve; n of 32 or more.
        reweightings: refinements of the weights: one leaves 1e-5 px, two 1e-7 px.

    Returns:
        The ellipse; exact (to rounding) if the contour is one. NaN if the conic is no ellipse.
    """
    xp = array_namespace(contour)
    with np.errstate(invalid="ignore"):
        state = contour, _fit(contour, xp.ones(contour.shape[:-1]))
        if xp is np:
            for step in range(reweightings):
                state = _refitted(step, state)
            return state[1]
    from jax.lax import fori_loop

    # Unrolled, the loop would take seconds to compile wherever it is used; and with a function of
    # this call's own it would be compiled at every call outside of jit.
    return fori_loop(0, reweightings, _refitted, state)[1]


def _refitted(
    _: int, state: tuple[Float[Array, "*batch n 2"], Ellipse]
) -> tuple[Float[Array, "*batch n 2"], Ellipse]:
    """The contour, and its ellipse with the weights that the last one has."""
    contour, ellipse = state
    return contour, _fit(contour, steps_of_eccentric_angle(contour, ellipse))


def ellipse_points(ellipse: Ellipse, angles: Float[Array, "n"]) -> Float[Array, "*batch n 2"]:
    """Points of an ellipse at eccentric angles (rad)."""
    xp = array_namespace(*ellipse, angles)
    cos_t = ellipse.semi_major[..., None] * xp.cos(angles)
    sin_t = ellipse.semi_minor[..., None] * xp.sin(angles)
    c, s = xp.cos(ellipse.angle)[..., None], xp.sin(ellipse.angle)[..., None]
    around = xp.stack([c * cos_t - s * sin_t, s * cos_t + c * sin_t], axis=-1)
    return ellipse.centre[..., None, :] + around


def in_unit_circle(
    points: Float[Array, "*batch n 2"], ellipse: Ellipse
) -> tuple[Float[Array, "*batch n"], Float[Array, "*batch n"]]:
    """Points in coordinates along the ellipse's axes, scaled so that it is the unit circle."""
    xp = array_namespace(points, *ellipse)
    c, s = xp.cos(ellipse.angle)[..., None], xp.sin(ellipse.angle)[..., None]
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
    return abs(p * dq - q * dp) / (p * p + q * q)


def _per_step(periodic: Float[Array, "*batch n"]) -> Float[Array, "*batch n"]:
    """Derivative of a periodic sequence by its index, of eighth order."""
    xp, reach, count = array_namespace(periodic), len(_CENTRAL_DIFFERENCE), periodic.shape[-1]
    round_it = xp.concatenate([periodic[..., -reach:], periodic, periodic[..., :reach]], axis=-1)
    return sum(
        weight
        * (round_it[..., reach + k : reach + k + count] - round_it[..., reach - k :][..., :count])
        for k, weight in enumerate(_CENTRAL_DIFFERENCE, 1)
    )


def _fit(contour: Float[Array, "*batch n 2"], weights: Float[Array, "*batch n"]) -> Ellipse:
    """Weighted algebraic least squares around the centroid."""
    xp = array_namespace(contour, weights)
    total = weights.sum(axis=-1)
    u, v = contour[..., 0], contour[..., 1]
    u0, v0 = (u * weights).sum(axis=-1) / total, (v * weights).sum(axis=-1) / total
    x, y = u - u0[..., None], v - v0[..., None]
    size = xp.sqrt((weights * (x * x + y * y)).sum(axis=-1) / total)
    x, y = x / size[..., None], y / size[..., None]
    a, b, c, d, e = _coefficients([x * x, x * y, y * y, x, y], weights)
    determinant = 4.0 * a * c - b * b
    x0 = (b * e - 2.0 * c * d) / determinant
    y0 = (b * d - 2.0 * a * e) / determinant
    level = 1.0 + a * x0 * x0 + b * x0 * y0 + c * y0 * y0
    mean, half_difference = 0.5 * (a + c), 0.5 * (a - c)
    circular = (half_difference == 0) & (b == 0)
    # A circle has no direction; the inner `where`s keep the derivatives finite.
    safe = xp.where(circular, 1.0, half_difference)
    spread = xp.where(circular, 0.0, xp.sqrt(safe**2 + 0.25 * b * b))
    angle = 0.5 * xp.arctan2(-0.5 * b, -safe)
    # (-pi/2, pi/2]: the major axis along v is +pi/2, whatever the sign of a zero.
    angle = xp.where(angle <= -0.5 * xp.pi, 0.5 * xp.pi, angle)
    return Ellipse(
        centre=xp.stack([u0 + size * x0, v0 + size * y0], axis=-1),
        semi_major=size * xp.sqrt(level / (mean - spread)),
        semi_minor=size * xp.sqrt(level / (mean + spread)),
        angle=xp.where(circular, 0.0, angle),
    )


def _coefficients(
    columns: list[Float[Array, "*batch n"]], weights: Float[Array, "*batch n"]
) -> list[Float[Array, "*batch"]]:
    """Coefficients whose sum of columns is nearest to 1, in weighted least squares."""
    xp = array_namespace(*columns, weights)
    if xp is np:
        rows = np.stack(columns, axis=-2)
        weighted = rows * weights[..., None, :]
        normal = weighted @ np.swapaxes(rows, -1, -2)
        found = np.linalg.solve(normal, weighted.sum(axis=-1)[..., None])
        return [found[..., k, 0] for k in range(len(columns))]
    # A batched LAPACK call costs about 2 us a system on a CPU; Cholesky's factors unrolled, the
    # arithmetic is vectorised over the batch and costs a twentieth of it.
    normal = [
        [(weights * column * other).sum(axis=-1) for other in columns[: row + 1]]
        for row, column in enumerate(columns)
    ]
    target = [(weights * column).sum(axis=-1) for column in columns]
    factor: list[list[Float[Array, "*batch"]]] = []
    for given in (*normal, target):  # with the target below, its row solves the lower triangle
        row: list[Float[Array, "*batch"]] = []
        for j, value in enumerate(given):
            above = factor[j] if j < len(factor) else row
            for left, right in zip(row, above, strict=False):
                value = value - left * right
            row.append(value / above[j] if j < len(factor) else xp.sqrt(value))
        factor.append(row)
    *factor, solution = factor
    for i in reversed(range(len(target))):
        for k in range(i + 1, len(target)):
            solution[i] = solution[i] - factor[k][i] * solution[k]
        solution[i] = solution[i] / factor[i][i]
    return solution
