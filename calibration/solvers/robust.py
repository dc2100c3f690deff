"""Huber's M-estimator, which limits the influence of outliers."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import optimistix as optx
from jaxtyping import Array, ArrayLike, Bool, Float

from calibration.solvers.levenberg_marquardt import GAUSS_NEWTON, Solution, least_squares

_TUNING = 1.345
"""In standard deviations; 95 % as efficient as least squares for normal noise (Huber 1981)."""
_MAD_OF_NORMAL = 0.6745
_OUTLIER = 3.5  # modified z-score from which Iglewicz and Hoaglin (1993) call a value an outlier
_MAX_STEPS = 256


class Robust(NamedTuple):
    """An M-estimate.

    Attributes:
        solution: with unweighted residuals and Huber's covariance.
        outliers: whether each residual exceeds 3.5 robust standard deviations.
    """

    solution: Solution
    outliers: Bool[Array, "n"]


def huber(
    residual: Callable[[Float[Array, "p"]], Float[Array, "n"]],
    start: Float[ArrayLike, "p"],
    *,
    weight: Float[ArrayLike, "n"],
) -> Robust:
    r"""Minimise Huber's loss by iteratively reweighted least squares.

    The scale is the median of the absolute residuals over 0.6745. Scale and parameters are a fixed
    point of the reweighting. The covariance is that of Huber (1981, eq. 6.5):
    $\kappa^2 \frac{\sum\psi^2/(n-p)}{(\overline{\psi'})^2} (J^T J)^{-1}$,
    $\kappa = 1 + \frac{p}{n}\frac{1 - \overline{\psi'}}{\overline{\psi'}}$.

    Args:
        residual: unweighted, almost linear function of the parameters; zero for padding.
        start: first guess.
        weight: 1, or 0 for padding.
    """
    real = jnp.asarray(weight) > 0
    count = jnp.sum(real)

    def scale(left: Float[Array, "n"]) -> Float[Array, ""]:
        return jnp.nanmedian(jnp.where(real, jnp.abs(left), jnp.nan)) / _MAD_OF_NORMAL

    def reweighted(parameters: Float[Array, "p"], _: None) -> Float[Array, "p"]:
        left = residual(parameters)
        # If the data fit exactly, the scale is 0 and every weight is 1.
        limit = _TUNING * scale(left)
        root = jnp.sqrt(jnp.where(jnp.abs(left) > limit, limit / jnp.abs(left), 1.0))
        return least_squares(
            lambda p: root * residual(p), parameters, count=count, solver=GAUSS_NEWTON
        ).parameters

    plain = least_squares(residual, start, count=count, solver=GAUSS_NEWTON)
    found: optx.Solution = optx.fixed_point(
        reweighted,
        optx.FixedPointIteration(rtol=1e-10, atol=1e-10),
        plain.parameters,
        max_steps=_MAX_STEPS,
        throw=False,
    )
    left = residual(found.value)
    jacobian = jax.jacfwd(residual)(found.value)
    information = jacobian.T @ jacobian
    spread, limit = scale(left), _TUNING * scale(left)
    within = jnp.sum(real & (jnp.abs(left) <= limit)) / count
    parameters = jacobian.shape[1]
    correction = 1.0 + parameters / count * (1.0 - within) / within
    variance = jnp.sum(jnp.clip(left, -limit, limit) ** 2) / (count - parameters)
    return Robust(
        Solution(
            parameters=found.value,
            covariance=correction**2 * variance / within**2 * jnp.linalg.inv(information),
            information=information,
            residuals=left,
            converged=(found.result == optx.RESULTS.successful) & plain.converged,
        ),
        outliers=(jnp.abs(left) > _OUTLIER * spread) & (spread > 0),
    )
