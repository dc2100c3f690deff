r"""One line through several trials, with touches and the plane's tilt as nuisances.

The robot's readings start at the touch, which the operator may miss, and the rim of a tilted tip
meets the wall before its centre does. So the distance is the reading plus a touch t_i. A tilted
plane is farther from the microscope at one spot than at another, and is seen more obliquely. To
first order in its tilt $\mathbf{s}$

$$ d_r + t_i = \delta k\,[1 + \kappa\,(\mathbf{X}_i + (\mathbf{X}_i\cdot\mathbf{n})\,\mathbf{n})
\cdot\mathbf{s}]\,e_1' + b $$

with $\kappa = 1/(z_F + r)$, $\mathbf{X}_i$ the spot's position and $\mathbf{n}$ its minor axis. The
model is linear except for the products $\delta k\,\mathbf{s}$, so the fit uses these instead of
the tilt.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from calibration.solvers import GAUSS_NEWTON, Solution, least_squares, padded
from calibration.spots.cone_trials import Prior
from calibration.spots.plane_fit import fit_plane

_ROUNDS = 8  # of the noise's estimate; each adds two digits if the priors are weaker than the data


class PlaneTrial(NamedTuple):
    """Spots of one withdrawal from a plane.

    Attributes:
        semi_minor_px: e1', px.
        readings: d_r, distance along the beam since the touch, mm.
        minor_axes: unit vectors along the ellipses' minor axes, n x 2, eye frame.
        place: (X, Y) of the spot, mm, eye frame.
        touch: distance at reading 0, mm.
    """

    semi_minor_px: Float[np.ndarray, "n"]
    readings: Float[np.ndarray, "n"]
    minor_axes: Float[np.ndarray, "n 2"]
    place: Float[np.ndarray, "2"]
    touch: Prior


class PlaneTrialsFit(NamedTuple):
    """One line for all trials, with the nuisances of each.

    Attributes:
        delta_k: mm per px.
        b: mm.
        covariance: covariance of delta_k and b, including the uncertainty of the nuisances.
        touch: distance at reading 0 per trial, mm.
        touch_error: its standard error, mm.
        tilt: tilt of the plane: tangents of its normal's angle from z, towards +X and +Y.
        tilt_error: its standard errors.
        r_squared: coefficient of determination.
        rmse: root mean square error, mm.
        residuals: the line's distance minus reading and touch, per spot in the given order, mm.
        noise: standard deviation of a spot's error, mm.
        converged: whether the solver converged.
    """

    delta_k: float
    b: float
    covariance: Float[np.ndarray, "2 2"]
    touch: Float[np.ndarray, "trials"]
    touch_error: Float[np.ndarray, "trials"]
    tilt: Float[np.ndarray, "2"]
    tilt_error: Float[np.ndarray, "2"]
    r_squared: float
    rmse: float
    residuals: Float[np.ndarray, "n"]
    noise: float
    converged: bool


def fit_plane_trials(
    trials: Sequence[PlaneTrial], *, inverse_working_distance: float, tilt_sigma: float
) -> PlaneTrialsFit:
    """Fit delta k and b to all trials, with each trial's touch and the plane's tilt.

    Args:
        trials: trials on one plane.
        inverse_working_distance: kappa, 1/mm; 0 is telecentric, where a tilt has no first-order
            effect.
        tilt_sigma: standard deviation of each component of the tilt around 0.

    Raises:
        InputError: as for `fit_plane` with all spots.
    """
    axis = np.concatenate([trial.semi_minor_px for trial in trials])
    readings = np.concatenate([trial.readings for trial in trials])
    pooled = fit_plane(semi_minor_px=axis, distance=readings)
    number = np.repeat(np.arange(len(trials)), [trial.readings.size for trial in trials])
    belongs = (number[:, None] == np.arange(len(trials))).astype(float)
    places = np.array([trial.place for trial in trials])[number]
    minor = np.concatenate([trial.minor_axes for trial in trials])
    oblique = np.sum(places * minor, axis=1, keepdims=True) * minor
    further = inverse_working_distance * (places + oblique) * axis[:, None]
    means, sigmas = np.array([trial.touch for trial in trials]).T
    # Columns: delta_k, b, delta_k times the tilt, touches over their sigma.
    expected = readings + belongs @ means
    design = np.column_stack([axis, np.ones(axis.size), further, -belongs * sigmas])
    *columns, expected, weight = padded(*design.T, expected)
    start = np.concatenate([[pooled.delta_k, pooled.b], np.zeros(2 + len(trials))])
    solution, noise = _solve(
        jnp.asarray(np.column_stack(columns)),
        jnp.asarray(expected),
        jnp.asarray(weight),
        jnp.asarray(start),
        jnp.asarray(tilt_sigma, float),
        jnp.asarray(max(pooled.rmse, np.finfo(float).tiny), float),
    )
    found = np.asarray(solution.parameters)
    covariance = np.linalg.inv(np.asarray(solution.information))
    errors = np.sqrt(np.diag(covariance))
    residuals = np.asarray(solution.residuals)[: axis.size] * float(noise)
    return PlaneTrialsFit(
        delta_k=float(found[0]),
        b=float(found[1]),
        covariance=covariance[:2, :2],
        touch=means + sigmas * found[4:],
        touch_error=sigmas * errors[4:],
        tilt=found[2:4] / found[0],
        tilt_error=errors[2:4] / abs(found[0]),
        r_squared=1.0 - float(np.sum(residuals**2) / np.sum((readings - readings.mean()) ** 2)),
        rmse=float(np.sqrt(np.mean(residuals**2))),
        residuals=residuals,
        noise=float(noise),
        converged=bool(solution.converged),
    )


@eqx.filter_jit
def _solve(
    design: Float[Array, "n p"],
    expected: Float[Array, "n"],
    weight: Float[Array, "n"],
    start: Float[Array, "p"],
    tilt_sigma: Float[Array, ""],
    noise: Float[Array, ""],
) -> tuple[Solution, Float[Array, ""]]:
    """The line, and the noise for which chi squared equals the number of degrees of freedom."""
    # Number of spots and priors minus parameters; every nuisance has a prior.
    degrees = jnp.sum(weight) - 2

    def given(noise: Float[Array, ""]) -> Solution:
        def residual(parameters: Array) -> Array:
            tilt = parameters[2:4] / (parameters[0] * tilt_sigma)
            misfit = weight * (design @ parameters - expected) / noise
            return jnp.concatenate([misfit, tilt, parameters[4:]])

        return least_squares(residual, start, count=degrees + start.size, solver=GAUSS_NEWTON)

    def refined(_: int, noise: Float[Array, ""]) -> Float[Array, ""]:
        return noise * jnp.sqrt(jnp.sum(given(noise).residuals ** 2) / degrees)

    noise = jax.lax.fori_loop(0, _ROUNDS, refined, noise)
    return given(noise), noise
