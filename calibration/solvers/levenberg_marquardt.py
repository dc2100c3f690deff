"""Nonlinear least squares by Optimistix."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import lineax  # type: ignore[import-untyped]
import numpy as np
import optimistix as optx
from jaxtyping import Array, ArrayLike, Float

_TOLERANCE = 1e-10
_MAX_STEPS = 256
_PADDING = 64

Solver = optx.AbstractLeastSquaresSolver

LEVENBERG_MARQUARDT: Solver = optx.LevenbergMarquardt(rtol=_TOLERANCE, atol=_TOLERANCE)
"""For distant starts, or if some directions are nearly undetermined."""
GAUSS_NEWTON: Solver = optx.GaussNewton(
    rtol=_TOLERANCE, atol=_TOLERANCE, linear_solver=lineax.Normal(lineax.Cholesky())
)
"""For few parameters of almost linear problems: it needs a few steps, also for batches."""


class Solution(NamedTuple):
    """Least-squares solution.

    Attributes:
        parameters: best point found, in the order of the start.
        covariance: s^2 (J^T J)^-1 with s^2 = sum of squares / (n - p).
        information: J^T J, whose inverse is the covariance if residuals are over their sigma.
        residuals: at the solution, in the residual function's unit.
        converged: whether the solver converged.
    """

    parameters: Float[Array, "p"]
    covariance: Float[Array, "p p"]
    information: Float[Array, "p p"]
    residuals: Float[Array, "n"]
    converged: bool | Array


def least_squares(
    residual: Callable[[Float[Array, "p"]], Float[Array, "n"]],
    start: Float[ArrayLike, "p"],
    *,
    count: ArrayLike,
    solver: Solver = LEVENBERG_MARQUARDT,
) -> Solution:
    """Minimise the sum of squared residuals.

    Args:
        residual: function of the parameters, differentiable by JAX; zero for padding.
        start: first guess.
        count: number of data without padding.
        solver: `LEVENBERG_MARQUARDT` or `GAUSS_NEWTON`.
    """
    result: optx.Solution = optx.least_squares(
        lambda parameters, _: residual(parameters),
        optx.BestSoFarLeastSquares(solver),
        jnp.asarray(start),
        max_steps=_MAX_STEPS,
        throw=False,
    )
    value = residual(result.value)
    jacobian = jax.jacfwd(residual)(result.value)
    information = jacobian.T @ jacobian
    variance = jnp.sum(value**2) / (count - jacobian.shape[1])
    return Solution(
        parameters=result.value,
        covariance=variance * jnp.linalg.inv(information),
        information=information,
        residuals=value,
        converged=result.result == optx.RESULTS.successful,
    )


def padded(*columns: Float[np.ndarray, "n"]) -> tuple[Float[np.ndarray, "m"], ...]:
    """Columns padded to a multiple of 64, followed by the weights (1, or 0 for padding).

    Trials have different numbers of frames; equal shapes avoid a compilation for each.
    """
    count = len(columns[0])
    missing = -count % _PADDING
    weight = np.concatenate([np.ones(count), np.zeros(missing)])
    return (*(np.pad(column, (0, missing)) for column in columns), weight)
