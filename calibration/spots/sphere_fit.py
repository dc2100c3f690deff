"""c of one withdrawal in an eyeball: Table II of Zhou et al. 2020.

`fit_eccentricity` checks the data of one trial and returns its row of the table. `sphere_solution`
solves the problem as a pure function of arrays, for `jax.vmap` over many trials.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float
from scipy import stats

import optics
from calibration.solvers import GAUSS_NEWTON, Robust, Solution, huber, least_squares, padded
from calibration.spots.plane_fit import Loss, outlier_indices
from formats.inputs import InputError

_FEWEST_SPOTS = 2
# Below this phi, cos(phi) differs from 1 by less than 5e-5, which no measurement resolves.
_PHI_BOUND = 0.01
_SQUARE = np.ones(1)  # cos(phi) at the pole


class SphereFit(NamedTuple):
    """c of the small-plane model, with the columns of the paper's Table II.

    Attributes:
        c: best eccentricity, mm; 0 if the fit is at its bound (`at_bound`).
        c_error: standard error for given delta_k and b, mm; NaN at the bound, where the derivative
            of the model is 0.
        standard_deviation: standard deviation of the errors (estimate - truth), mm.
        mean_absolute_error: mm.
        max_error: largest absolute error, mm.
        spots: number of spots fitted.
        converged: whether the solver converged.
        at_bound: whether the fit is at the bound c = 0.
        outliers: indices of spots beyond 3.5 robust standard deviations, with the loss "huber".
        sensitivity: derivatives of c with respect to delta_k (px) and b (1), for error propagation.
    """

    c: float
    c_error: float
    standard_deviation: float
    mean_absolute_error: float
    max_error: float
    spots: int
    converged: bool
    at_bound: bool
    outliers: tuple[int, ...] = ()
    sensitivity: tuple[float, float] = (math.nan, math.nan)

    def band(
        self,
        semi_minor_px: Float[ArrayLike, "n"],
        *,
        delta_k: float,
        scale: float,
        eye_radius: float,
        level: float = 0.95,
    ) -> Float[np.ndarray, "n"]:
        """Half-width of the curve's confidence band due to c alone, by Student's t; mm.

        Args: as for `fit_eccentricity`; `level` is the level of confidence.
        """

        def at(c: Array) -> Array:
            return optics.small_plane_distance(
                semi_minor_px=jnp.asarray(semi_minor_px, float),
                scale=scale,
                k=delta_k / scale,
                b=0.0,
                eccentricity=c,
                eye_radius=eye_radius,
            )

        slope = np.abs(jax.jacfwd(at)(jnp.asarray(self.c, float)))
        return stats.t.ppf(0.5 + 0.5 * level, self.spots - 1) * self.c_error * slope


def fit_eccentricity(
    *,
    semi_minor_px: Float[ArrayLike, "n"],
    distance: Float[ArrayLike, "n"],
    delta_k: float,
    b: float,
    scale: float,
    eye_radius: float,
    loss: Loss = "squares",
) -> SphereFit:
    """Fit c of the small-plane model to spots in a sphere, as the paper's Table II does.

    Args:
        semi_minor_px: e1', px.
        distance: d_r, mm.
        delta_k: slope fitted to the plane, mm per px.
        b: offset fitted to the plane, mm.
        scale: delta, mm/px; the sagitta term needs it, although the paper does not state it.
        eye_radius: r, mm.
        loss: see `Loss`.

    Raises:
        InputError: fewer than 2 spots.
    """
    axis, reading = np.asarray(semi_minor_px, float), np.asarray(distance, float)
    if axis.size < _FEWEST_SPOTS:
        raise InputError(f"fit_eccentricity needs {_FEWEST_SPOTS} spots or more; got {axis.size}.")
    given = {"delta_k": delta_k, "b": b, "scale": scale, "eye_radius": eye_radius}
    (solution, outliers), sensitivity = _solve_sphere(
        *padded(axis, reading),
        # As arrays, so that one compilation is valid for all values.
        **{name: jnp.asarray(value, float) for name, value in given.items()},
        loss=loss,
    )
    cos_phi = min(float(solution.parameters[0]), 1.0)
    at_bound = cos_phi > math.cos(_PHI_BOUND)
    c = eye_radius * math.sqrt(1.0 - cos_phi**2)
    per_cos_phi = math.nan if at_bound else -(eye_radius**2) * cos_phi / c
    errors = np.asarray(
        _misfit(jnp.minimum(solution.parameters, 1.0), axis, reading, delta_k, b, scale, eye_radius)
    )
    return SphereFit(
        c=c,
        c_error=abs(per_cos_phi) * math.sqrt(solution.covariance[0, 0]),
        standard_deviation=float(np.std(errors, ddof=1)),
        mean_absolute_error=float(np.mean(np.abs(errors))),
        max_error=float(np.max(np.abs(errors))),
        spots=axis.size,
        converged=bool(solution.converged),
        at_bound=at_bound,
        outliers=outlier_indices(outliers),
        sensitivity=(per_cos_phi * float(sensitivity[0]), per_cos_phi * float(sensitivity[1])),
    )


def sphere_solution(
    axis: Float[ArrayLike, "n"],
    reading: Float[ArrayLike, "n"],
    weight: Float[ArrayLike, "n"],
    *,
    delta_k: ArrayLike,
    b: ArrayLike,
    scale: ArrayLike,
    eye_radius: ArrayLike,
) -> Solution:
    """Least squares for (cos(phi),); arguments as in `fit_eccentricity`, weight 0 or 1.

    The model is almost linear in cos(phi) = sqrt(1 - (c/r)^2). A value above 1 means that c = 0
    fits best.
    """

    def residual(parameters: Array) -> Array:
        misfit = _misfit(parameters, axis, reading, delta_k, b, scale, eye_radius)
        return jnp.asarray(weight) * misfit

    return least_squares(residual, _SQUARE, count=jnp.sum(weight), solver=GAUSS_NEWTON)


def _misfit(
    parameters: Float[Array, "1"],
    axis: ArrayLike,
    reading: ArrayLike,
    delta_k: ArrayLike,
    b: ArrayLike,
    scale: ArrayLike,
    eye_radius: ArrayLike,
) -> Float[Array, "n"]:
    """Errors of the small-plane model with the parameter (cos(phi),), mm."""
    radius = scale * jnp.asarray(axis) * parameters[0]
    return (
        optics.sphere_distance(spot_radius=radius, k=delta_k / scale, b=b, eye_radius=eye_radius)
        - reading
    )


@eqx.filter_jit
def _solve_sphere(
    axis: ArrayLike,
    reading: ArrayLike,
    weight: ArrayLike,
    *,
    delta_k: Array,
    b: Array,
    scale: Array,
    eye_radius: Array,
    loss: Loss,
) -> tuple[Robust, Float[Array, "2"]]:
    """The solution, and d cos(phi) / d (delta_k, b) by the implicit function theorem."""

    def misfit(parameters: Array, line: Array) -> Array:
        misfit = _misfit(parameters, axis, reading, line[0], line[1], scale, eye_radius)
        return jnp.asarray(weight) * misfit

    line = jnp.stack([delta_k, b])
    if loss == "huber":
        found = huber(lambda p: misfit(p, line), jnp.asarray(_SQUARE), weight=weight)
    else:
        solution = sphere_solution(
            axis, reading, weight, delta_k=line[0], b=line[1], scale=scale, eye_radius=eye_radius
        )
        found = Robust(solution, jnp.zeros(jnp.shape(axis), bool))
    own, given = jax.jacfwd(misfit, argnums=(0, 1))(found.solution.parameters, line)
    return found, -(own[:, 0] @ given) / (own[:, 0] @ own[:, 0])
