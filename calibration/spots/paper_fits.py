r"""The paper's fits: a line through spots on a plane, and c of a withdrawal in an eyeball.

`fit_plane` and `fit_eccentricity` return the rows of Tables I and II of Zhou et al. 2020, each of
one withdrawal; `fit_lines` returns many of Table I, without standard errors.

`PlaneTrial`s share one line, with touches and the plane's tilt as nuisances. The robot's readings
start at the touch, which the operator may miss, and the rim of a tilted tip meets the wall before
its centre does. So the distance is the reading plus a touch t_i. A tilted plane is farther from the
microscope at one spot than at another, and is seen more obliquely. To first order in its tilt
$\mathbf{s}$

$$ d_r + t_i = \delta k\,[1 + \kappa\,(\mathbf{X}_i + (\mathbf{X}_i\cdot\mathbf{n})\,\mathbf{n})
\cdot\mathbf{s}]\,e_1' + b $$

with $\kappa = 1/(z_F + r)$, $\mathbf{X}_i$ the spot's position and $\mathbf{n}$ its minor axis. The
model is linear except for the products $\delta k\,\mathbf{s}$, so the fit uses these instead of the
tilt.
"""

import math
from collections.abc import Callable, Sequence
from typing import Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Float
from scipy import stats

from eyespot import optics
from eyespot.calibration.least_squares import GAUSS_NEWTON, Solution, huber, least_squares, padded
from eyespot.calibration.spots.cone_trials import Prior
from eyespot.formats.inputs import InputError

Loss = Literal["squares", "huber"]
"""Least squares, or Huber's loss, which finds outliers."""

_PADDED_SPOTS = 64  # spots: withdrawals of nearly equal length share one compilation


def _padded(sizes: ArrayLike, readings: ArrayLike) -> tuple[Array, Array, Array]:
    """Both padded to a multiple of 64 rows, and the weights (1, or 0 for padding)."""
    count = len(np.asarray(readings))
    length = count + -count % _PADDED_SPOTS
    weight = jnp.where(jnp.arange(length) < count, 1.0, 0.0)
    return jnp.asarray(padded(sizes, length)), jnp.asarray(padded(readings, length)), weight


@eqx.filter_jit
def _solved(
    misfit: Callable[..., Float[Array, "n"]],
    start: Float[Array, "p"],
    given: Float[Array, "q"],
    *spots: Float[Array, "n"],
    loss: Loss,
) -> tuple[Solution, Bool[Array, "n"], Float[Array, "p q"]]:
    """The solution, which spots are outliers, and the parameters' derivatives by what is given.

    Args:
        misfit: function of the parameters, of what is given, and of size and reading of the spots.
        given: what is not fitted; the implicit function theorem gives the derivatives.
        spots: sizes, readings and weights.
    """
    *seen, weight = spots

    def residual(parameters: Array, given: Array) -> Array:
        return weight * misfit(parameters, given, *seen)

    def own(parameters: Array) -> Array:
        return residual(parameters, given)

    if loss == "huber":
        solution, outliers = huber(own, start, weight=weight)
    else:
        solution = least_squares(own, start, count=jnp.sum(weight), solver=GAUSS_NEWTON)
        outliers = jnp.zeros(weight.shape, bool)
    slopes, of_given = jax.jacfwd(residual, argnums=(0, 1))(solution.parameters, given)
    return solution, outliers, -jnp.linalg.solve(slopes.T @ slopes, slopes.T @ of_given)


class PlaneFit(NamedTuple):
    """d = delta k e1' + b, with the columns of the paper's Table I and standard errors.

    Attributes:
        delta_k: mm per px; its standard error, too.
        b: mm; its standard error, too.
        covariance: of delta_k and b.
        r_squared: coefficient of determination.
        rmse: root mean square error, mm.
        spots: number of spots fitted.
        outliers: indices of spots beyond 3.5 robust standard deviations, with the loss "huber".
    """

    delta_k: float
    b: float
    delta_k_error: float
    b_error: float
    covariance: Float[np.ndarray, "2 2"]
    r_squared: float
    rmse: float
    spots: int
    converged: bool
    outliers: tuple[int, ...] = ()

    def band(self, semi_minor_px: Float[ArrayLike, "n"]) -> Float[np.ndarray, "n"]:
        """Half-width of the line's 95 % confidence band, pointwise, by Student's t; mm.

        Args:
            semi_minor_px: e1', px.
        """
        rows = np.stack([np.asarray(semi_minor_px, float), np.ones(np.shape(semi_minor_px))], -1)
        sigma = np.sqrt(np.einsum("...i,ij,...j->...", rows, self.covariance, rows))
        return stats.t.ppf(0.975, self.spots - 2) * sigma


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

    Raises:
        InputError: fewer than 3 spots, or spots of one size only.

    Example:
        >>> fit = fit_plane(semi_minor_px=[40, 50, 60, 70], distance=[0.25, 1.57, 2.92, 4.27])
        >>> round(fit.delta_k, 4), round(fit.b, 3)
        (0.1341, -5.123)
    """
    axis, reading = np.asarray(semi_minor_px, float), np.asarray(distance, float)
    if axis.size < 3 or np.ptp(axis) == 0:
        raise InputError(
            f"fit_plane needs 3 spots or more of different sizes; got "
            f"{axis.size} with a range of {np.ptp(axis) if axis.size else 0:g} px. Add frames at "
            "other distances."
        )
    start = jnp.array([0.1, 0.0])
    solution, outliers, _ = _solved(
        _plane_misfit, start, jnp.zeros(0), *_padded(axis, reading), loss=loss
    )
    spread = float(np.sum((reading - reading.mean()) ** 2))
    squares = float(np.sum(np.square(solution.residuals)))
    errors = np.sqrt(np.diag(solution.covariance))
    return PlaneFit(
        delta_k=float(solution.parameters[0]),
        b=float(solution.parameters[1]),
        delta_k_error=float(errors[0]),
        b_error=float(errors[1]),
        covariance=np.asarray(solution.covariance),
        r_squared=1.0 - squares / spread,
        rmse=float(np.sqrt(squares / axis.size)),
        spots=axis.size,
        converged=bool(solution.converged),
        outliers=tuple(np.flatnonzero(outliers).tolist()),
    )


def _plane_misfit(line: Array, _: Array, axis: Array, reading: Array) -> Array:
    delta_k, b = line
    return optics.planar_distance(semi_minor_px=axis, scale=delta_k, k=1.0, b=b) - reading


class Lines(NamedTuple):
    """The columns of Table I as arrays over trials (Zhou et al. 2020).

    Attributes:
        delta_k: mm/px, or k if the spots are given in mm; the others as in `PlaneFit`.
    """

    delta_k: np.ndarray
    b: np.ndarray
    r_squared: np.ndarray
    rmse: np.ndarray


def fit_lines(semi_minor: np.ndarray, reading: np.ndarray) -> Lines:
    """Least squares of d_r on e1': the same line as `fit_plane`, without standard errors.

    Args:
        semi_minor: e1', ... x n, px or mm; NaN for frames without a spot.
        reading: d_r, mm; broadcasts against `semi_minor`.

    Returns:
        Arrays of the shape ...; NaN for trials with fewer than three spots, or with equal sizes.
    """
    seen = np.isfinite(semi_minor)
    count = np.count_nonzero(seen, axis=-1)
    reading = np.where(seen, reading, 0.0)
    with np.errstate(invalid="ignore", divide="ignore"):

        def mean(values: np.ndarray) -> np.ndarray:
            return np.asarray(np.sum(values, axis=-1) / count)

        axis = np.where(seen, semi_minor, 0.0)
        mean_axis, mean_reading = mean(axis), mean(reading)
        axis = np.where(seen, axis - mean_axis[..., None], 0.0)
        offset = np.where(seen, reading - mean_reading[..., None], 0.0)
        delta_k = mean(axis * offset) / mean(axis**2)
        squares = mean((offset - delta_k[..., None] * axis) ** 2)
        line = Lines(
            delta_k=delta_k,
            b=mean_reading - delta_k * mean_axis,
            r_squared=1.0 - squares / mean(offset**2),
            rmse=np.sqrt(squares),
        )
    return Lines(*(np.where(count >= 3, value, np.nan) for value in line))


# Below this phi, cos(phi) differs from 1 by less than 5e-5, which no measurement resolves.
_PHI_BOUND = 0.01


class SphereFit(NamedTuple):
    """c of the small-plane model, with the columns of the paper's Table II.

    Attributes:
        c: best eccentricity, mm; 0 if the fit is at its bound (`at_bound`).
        c_error: standard error for given delta_k and b, mm; NaN at the bound, where the derivative
            of the model is 0.
        standard_deviation: standard deviation of the errors (estimate - truth), mm.
        mean_absolute_error: mm.
        max_error: largest absolute error, mm.
        at_bound: whether the fit is at the bound c = 0.
        outliers: as in `PlaneFit`.
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
    ) -> Float[np.ndarray, "n"]:
        """Half-width of the curve's 95 % confidence band due to c alone, by Student's t; mm.

        Args: as for `fit_eccentricity`.
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
        return stats.t.ppf(0.975, self.spots - 1) * self.c_error * slope


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

    Raises:
        InputError: fewer than 2 spots.
    """
    axis, reading = np.asarray(semi_minor_px, float), np.asarray(distance, float)
    if axis.size < 2:
        raise InputError(f"fit_eccentricity needs 2 spots or more; got {axis.size}.")
    # As an array, so that one compilation is valid for all values.
    given = jnp.array([delta_k, b, scale, eye_radius], float)
    # The model is almost linear in cos(phi), which is 1 at the pole.
    solution, outliers, slopes = _solved(
        _sphere_misfit, jnp.ones(1), given, *_padded(axis, reading), loss=loss
    )
    cos_phi = min(float(solution.parameters[0]), 1.0)
    at_bound = cos_phi > math.cos(_PHI_BOUND)
    c = eye_radius * math.sqrt(1.0 - cos_phi**2)
    per_cos_phi = math.nan if at_bound else -(eye_radius**2) * cos_phi / c
    errors = np.asarray(_sphere_misfit(jnp.minimum(solution.parameters, 1.0), given, axis, reading))
    return SphereFit(
        c=c,
        c_error=abs(per_cos_phi) * math.sqrt(solution.covariance[0, 0]),
        standard_deviation=float(np.std(errors, ddof=1)),
        mean_absolute_error=float(np.mean(np.abs(errors))),
        max_error=float(np.max(np.abs(errors))),
        spots=axis.size,
        converged=bool(solution.converged),
        at_bound=at_bound,
        outliers=tuple(np.flatnonzero(outliers).tolist()),
        sensitivity=(per_cos_phi * float(slopes[0, 0]), per_cos_phi * float(slopes[0, 1])),
    )


def _sphere_misfit(cos_phi: Array, given: Array, axis: ArrayLike, reading: ArrayLike) -> Array:
    """Errors of the small-plane model, mm; cos(phi) = sqrt(1 - (c/r)^2) above 1 means c = 0."""
    delta_k, b, scale, eye_radius = given
    radius = scale * jnp.asarray(axis) * cos_phi[0]
    return (
        optics.sphere_distance(spot_radius=radius, k=delta_k / scale, b=b, eye_radius=eye_radius)
        - reading
    )


_NOISE_ROUNDS = 8  # each adds two digits to the noise if the priors are weaker than the data


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
        delta_k: mm per px; b, r_squared and rmse as in `PlaneFit`.
        covariance: of delta_k and b, including the uncertainty of the nuisances.
        touch: distance at reading 0 per trial, mm; its standard error, too.
        tilt: tilt of the plane: tangents of its normal's angle from z, towards +X and +Y.
        residuals: the line's distance minus reading and touch, per spot in the given order, mm.
        noise: standard deviation of a spot's error, mm.
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
    start = np.concatenate([[pooled.delta_k, pooled.b], np.zeros(2 + len(trials))])
    solution, noise = _plane_trials(
        *_padded(design, expected),
        start=jnp.asarray(start),
        tilt_sigma=jnp.asarray(tilt_sigma, float),
        noise=jnp.asarray(max(pooled.rmse, np.finfo(float).tiny), float),
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
def _plane_trials(
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

    noise = jax.lax.fori_loop(0, _NOISE_ROUNDS, refined, noise)
    return given(noise), noise
