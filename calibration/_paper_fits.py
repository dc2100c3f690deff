"""The fits of Zhou et al. 2020: delta k and b on planes (Table I), c in spheres (Table II)."""

from __future__ import annotations

import math
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

import optics
from calibration._least_squares import Solution, least_squares, padded

_FEWEST_PLANE_SPOTS = 3
_FEWEST_SPHERE_SPOTS = 2
# cos(phi) differs from 1 by less than 5e-5 below it: no data of a spot can tell that from c = 0.
_PHI_BOUND = 0.01


class PlaneFit(NamedTuple):
    """d = delta k e1' + b, with what the paper's Table I lists, and standard errors.

    Attributes:
        delta_k: mm per px.
        b: mm.
        delta_k_error: standard error of delta_k, mm per px.
        b_error: standard error of b, mm.
        correlation: of the two errors.
        r_squared: coefficient of determination.
        rmse: root mean square error, mm.
        spots: number of spots fitted.
        converged: whether the solver converged.
    """

    delta_k: float
    b: float
    delta_k_error: float
    b_error: float
    correlation: float
    r_squared: float
    rmse: float
    spots: int
    converged: bool


class SphereFit(NamedTuple):
    """c of the small-plane model, with what the paper's Table II lists.

    Attributes:
        c: eccentricity that fits best, mm; 0 where the data ask for none (`at_bound`).
        c_error: standard error, mm; NaN at the bound, where the model has no slope.
        standard_deviation: of the errors (estimate - truth), mm.
        mean_absolute_error: mm.
        max_error: largest absolute error, mm.
        spots: number of spots fitted.
        converged: whether the solver converged.
        at_bound: the fit ran into c = 0.
    """

    c: float
    c_error: float
    standard_deviation: float
    mean_absolute_error: float
    max_error: float
    spots: int
    converged: bool
    at_bound: bool


def fit_plane(*, semi_minor_px: Float[ArrayLike, "n"], distance: Float[ArrayLike, "n"]) -> PlaneFit:
    """Fit delta k and b to spots on a plane (Zhou et al. 2020, eq. 7).

    Args:
        semi_minor_px: e1', px.
        distance: d_r, reading of the robot since contact, mm.

    Raises:
        ValueError: fewer than 3 spots, or all of one size.
    """
    axis, reading = np.asarray(semi_minor_px, float), np.asarray(distance, float)
    if axis.size < _FEWEST_PLANE_SPOTS or np.ptp(axis) == 0:
        raise ValueError(
            f"fit_plane needs {_FEWEST_PLANE_SPOTS} spots or more of different sizes; got "
            f"{axis.size} with a range of {np.ptp(axis) if axis.size else 0:g} px. Add frames at "
            "other distances."
        )
    solution = _solve_plane(*padded(axis, reading))
    spread = float(np.sum((reading - reading.mean()) ** 2))
    squares = float(np.sum(np.square(solution.residuals)))
    errors = np.sqrt(np.diag(solution.covariance))
    return PlaneFit(
        delta_k=float(solution.parameters[0]),
        b=float(solution.parameters[1]),
        delta_k_error=float(errors[0]),
        b_error=float(errors[1]),
        correlation=float(solution.covariance[0, 1] / (errors[0] * errors[1])),
        r_squared=1.0 - squares / spread,
        rmse=float(np.sqrt(squares / axis.size)),
        spots=axis.size,
        converged=bool(solution.converged),
    )


def fit_eccentricity(
    *,
    semi_minor_px: Float[ArrayLike, "n"],
    distance: Float[ArrayLike, "n"],
    delta_k: float,
    b: float,
    scale: float,
    eye_radius: float,
) -> SphereFit:
    """Fit c of the small-plane model to spots in a sphere, as the paper's Table II does.

    Args:
        semi_minor_px: e1', px.
        distance: d_r, mm.
        delta_k: from the plane, mm per px.
        b: from the plane, mm.
        scale: delta, mm/px; the paper leaves it open, though the sagitta term needs it.
        eye_radius: r, mm.

    Raises:
        ValueError: fewer than 2 spots.
    """
    axis, reading = np.asarray(semi_minor_px, float), np.asarray(distance, float)
    if axis.size < _FEWEST_SPHERE_SPOTS:
        raise ValueError(
            f"fit_eccentricity needs {_FEWEST_SPHERE_SPOTS} spots or more; got {axis.size}."
        )
    solution = _solve_sphere(
        *padded(axis, reading), delta_k=delta_k, b=b, scale=scale, eye_radius=eye_radius
    )
    phi = float(solution.parameters[0])
    errors = np.asarray(solution.residuals)[: axis.size]
    at_bound = abs(np.sin(phi)) < _PHI_BOUND
    return SphereFit(
        c=float(eye_radius * abs(np.sin(phi))),
        c_error=math.nan
        if at_bound
        else float(eye_radius * abs(np.cos(phi)) * np.sqrt(solution.covariance[0, 0])),
        standard_deviation=float(np.std(errors, ddof=1)),
        mean_absolute_error=float(np.mean(np.abs(errors))),
        max_error=float(np.max(np.abs(errors))),
        spots=axis.size,
        converged=bool(solution.converged),
        at_bound=bool(at_bound),
    )


@eqx.filter_jit
def _solve_plane(axis: ArrayLike, reading: ArrayLike, weight: ArrayLike) -> Solution:
    def residual(parameters: Array) -> Array:
        delta_k, b = parameters
        return weight * (
            optics.planar_distance(semi_minor_px=axis, scale=delta_k, k=1.0, b=b) - reading
        )

    return least_squares(residual, jnp.array([0.1, 0.0]), count=jnp.sum(weight))


@eqx.filter_jit
def _solve_sphere(
    axis: ArrayLike,
    reading: ArrayLike,
    weight: ArrayLike,
    *,
    delta_k: ArrayLike,
    b: ArrayLike,
    scale: ArrayLike,
    eye_radius: ArrayLike,
) -> Solution:
    # phi is free and c = r |sin(phi)|: the model is even in phi, so c = 0 needs no bound.
    def residual(parameters: Array) -> Array:
        estimate = optics.small_plane_distance(
            semi_minor_px=axis,
            scale=scale,
            k=delta_k / scale,
            b=b,
            eccentricity=eye_radius * jnp.sin(parameters[0]),
            eye_radius=eye_radius,
        )
        return jnp.asarray(weight) * (estimate - reading)

    return least_squares(residual, jnp.array([0.4]), count=jnp.sum(weight))
