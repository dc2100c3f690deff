"""delta k and b of one withdrawal from a plane: Table I of Zhou et al. 2020.

`fit_plane` checks the data of one trial and returns its row of the table. `plane_solution` solves
the problem as a pure function of arrays, for `jax.vmap` over many trials.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float
from scipy import stats

import optics
from calibration.solvers import GAUSS_NEWTON, Robust, Solution, huber, least_squares, padded
from optics import InputError

Loss = Literal["squares", "huber"]
"""Least squares, or Huber's loss, which finds outliers."""

_FEWEST_SPOTS = 3
_LINE_START = np.array([0.1, 0.0])  # delta k, mm/px, and b, mm


class PlaneFit(NamedTuple):
    """d = delta k e1' + b, with the columns of the paper's Table I and standard errors.

    Attributes:
        delta_k: mm per px.
        b: mm.
        delta_k_error: standard error of delta_k, mm per px.
        b_error: standard error of b, mm.
        correlation: correlation of the two errors.
        r_squared: coefficient of determination.
        rmse: root mean square error, mm.
        spots: number of spots fitted.
        converged: whether the solver converged.
        outliers: indices of spots beyond 3.5 robust standard deviations, with the loss "huber".
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
    outliers: tuple[int, ...] = ()

    @property
    def covariance(self) -> Float[np.ndarray, "2 2"]:
        """Covariance of delta_k and b."""
        mixed = self.correlation * self.delta_k_error * self.b_error
        return np.array([[self.delta_k_error**2, mixed], [mixed, self.b_error**2]])

    def band(
        self, semi_minor_px: Float[ArrayLike, "n"], *, level: float = 0.95
    ) -> Float[np.ndarray, "n"]:
        """Half-width of the line's confidence band, pointwise, by Student's t; mm.

        Args:
            semi_minor_px: e1', px.
            level: level of confidence.
        """
        rows = np.stack([np.asarray(semi_minor_px, float), np.ones(np.shape(semi_minor_px))], -1)
        sigma = np.sqrt(np.einsum("...i,ij,...j->...", rows, self.covariance, rows))
        return stats.t.ppf(0.5 + 0.5 * level, self.spots - 2) * sigma


def fit_plane(
    *,
    semi_minor_px: Float[ArrayLike, "n"],
    distance: Float[ArrayLike, "n"],
    loss: Loss = "squares",
) -> PlaneFit:
    """Fit delta k and b to spots on a plane (Zhou et al. 2020, eq. 6).

    Args:
        semi_minor_px: e1', px.
        distance: d_r, the robot's reading since contact, mm.
        loss: see `Loss`.

    Raises:
        InputError: fewer than 3 spots, or spots of one size only.

    Example:
        >>> fit = fit_plane(semi_minor_px=[40, 50, 60, 70], distance=[0.25, 1.57, 2.92, 4.27])
        >>> round(fit.delta_k, 4), round(fit.b, 3)
        (0.1341, -5.123)
    """
    axis, reading = np.asarray(semi_minor_px, float), np.asarray(distance, float)
    if axis.size < _FEWEST_SPOTS or np.ptp(axis) == 0:
        raise InputError(
            f"fit_plane needs {_FEWEST_SPOTS} spots or more of different sizes; got "
            f"{axis.size} with a range of {np.ptp(axis) if axis.size else 0:g} px. Add frames at "
            "other distances."
        )
    solution, outliers = _solve_plane(*padded(axis, reading), loss=loss)
    spread = float(np.sum((reading - reading.mean()) ** 2))
    squares = float(np.sum(np.square(solution.residuals)))
    errors = np.sqrt(np.diag(solution.covariance))
    # If the spots fit exactly, the errors are rounding errors, without a defined correlation.
    correlation = solution.covariance[0, 1] / (errors[0] * errors[1]) if errors.all() else 0.0
    return PlaneFit(
        delta_k=float(solution.parameters[0]),
        b=float(solution.parameters[1]),
        delta_k_error=float(errors[0]),
        b_error=float(errors[1]),
        correlation=float(correlation),
        r_squared=1.0 - squares / spread,
        rmse=float(np.sqrt(squares / axis.size)),
        spots=axis.size,
        converged=bool(solution.converged),
        outliers=outlier_indices(outliers),
    )


def plane_solution(
    axis: Float[ArrayLike, "n"], reading: Float[ArrayLike, "n"], weight: Float[ArrayLike, "n"]
) -> Solution:
    """Least squares for (delta_k, b), mm/px and mm; arguments as in `fit_plane`, weight 0 or 1."""
    return least_squares(
        _line(axis, reading, weight), _LINE_START, count=jnp.sum(weight), solver=GAUSS_NEWTON
    )


def _line(axis: ArrayLike, reading: ArrayLike, weight: ArrayLike) -> Callable[[Array], Array]:
    def residual(parameters: Array) -> Array:
        delta_k, b = parameters
        line = optics.planar_distance(semi_minor_px=axis, scale=delta_k, k=1.0, b=b)
        return weight * (line - reading)

    return residual


@eqx.filter_jit
def _solve_plane(axis: ArrayLike, reading: ArrayLike, weight: ArrayLike, *, loss: Loss) -> Robust:
    if loss == "huber":
        return huber(_line(axis, reading, weight), jnp.asarray(_LINE_START), weight=weight)
    return Robust(plane_solution(axis, reading, weight), jnp.zeros(jnp.shape(axis), bool))


def outlier_indices(flags: Array) -> tuple[int, ...]:
    """Indices of flagged spots."""
    return tuple(np.flatnonzero(flags).tolist())
