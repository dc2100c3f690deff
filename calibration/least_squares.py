"""Least squares: Levenberg-Marquardt, robust weights, normal equations, covariance.

`NormalEquations` need J^T J and J^T r, but no Jacobian in memory. Optimistix and SciPy need the
residuals or their Jacobian, which takes 24 GB for the pixels of 40 frames. The sums over pixels
used here can be computed in chunks.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import lineax  # type: ignore[import-untyped]
import numpy as np
import optimistix as optx
from jaxtyping import Array, ArrayLike, Bool, Float, Int
from scipy import stats
from scipy.fft import dct

from eyespot.estimator.information import Information

CHANCE = 1e-3
"""Probability that noise alone puts chi squared outside of the accepted range, on each side."""


def accepted_range(degrees_of_freedom: float) -> tuple[float, float]:
    """Range of chi squared per degree of freedom that noise alone explains."""
    low, high = stats.chi2.ppf((CHANCE, 1 - CHANCE), degrees_of_freedom)
    return float(low / degrees_of_freedom), float(high / degrees_of_freedom)


def excess_variance(chi_squared_per_degree: float, degrees_of_freedom: float) -> float:
    """Factor by which variances must grow if residuals without structure exceed their noise.

    It is chi squared per degree of freedom (Birge 1932) if noise alone does not explain it, and 1
    otherwise.
    """
    _, high = accepted_range(degrees_of_freedom)
    return chi_squared_per_degree if chi_squared_per_degree > high else 1.0


SIGNIFICANCE = 0.01
"""Probability that random residuals have structure of at least one kind."""
_FOLLOWED, _SLOW = 2, 5  # waves that fits follow, and that are slow besides


def slow_power(values: Float[np.ndarray, "n"]) -> tuple[float, float]:
    """Power of the slow waves of residuals, and the chance that noise has as much beside the rest.

    A model's misfit changes slowly from frame to frame, and so do the derivatives by its
    parameters. So the slow waves of cosines that a fit does not follow tell how much larger its
    parameters' variances are than noise without structure makes them (F test beside the others).

    Args:
        values: residuals with variance 1, ordered so that a misfit affects neighbours alike.

    Returns:
        1 and 1 for three values or fewer, of which a fit follows all but one.
    """
    waves = np.square(dct(values, norm="ortho")[_FOLLOWED:])
    if waves.size < 2:
        return 1.0, 1.0
    slow, rest = np.split(waves, [max(1, min(_SLOW, len(values) // 4))])
    ratio = np.mean(slow) / max(np.mean(rest), _NOTHING)
    return float(np.mean(slow)), float(stats.f.sf(ratio, slow.size, rest.size))


def slow_waves(
    residuals: Mapping[str, Float[np.ndarray, "n"]],
) -> list[tuple[str, float, float, bool]]:
    """Name, power and chance of each kind of residuals, and whether it has structure.

    Noise has structure of at least one kind with the probability `SIGNIFICANCE`.
    """
    powers = [(name, *slow_power(values)) for name, values in residuals.items()]
    level = SIGNIFICANCE / max(len(powers), 1)
    return [(name, power, chance, chance < level) for name, power, chance in powers]


MOST_STEPS = 40
_DAMPING, _MOST_DAMPING = 1e-6, 1e8
_NOTHING = 1e-300


class NormalEquations(NamedTuple):
    """Quadratic approximation of a sum of squares at a point.

    Attributes:
        cost: sum of squared residuals; infinite for impossible parameters.
        gradient: J^T r.
        information: J^T J.
    """

    cost: float
    gradient: Float[np.ndarray, "p"]
    information: Float[np.ndarray, "p p"]


class Minimum(NamedTuple):
    """The last point.

    Attributes:
        first: cost at the start.
        gain: by how much another step would lower the cost, to first order.
        steps: number of evaluations after the first.
    """

    x: Float[np.ndarray, "p"]
    at: NormalEquations
    first: float
    gain: float
    steps: int
    converged: bool


def minimise(
    evaluate: Callable[[Float[np.ndarray, "p"]], NormalEquations],
    start: Float[np.ndarray, "p"],
    *,
    tolerance: float,
    most_steps: int = MOST_STEPS,
) -> Minimum:
    """Levenberg-Marquardt with Nielsen's damping.

    It ends when an undamped step would lower the cost by less than the tolerance. If the cost is
    chi squared, this is the square of the step in standard errors (Nielsen 1999, "Damping parameter
    in Marquardt's method").

    After `most_steps` evaluations it ends anyway.
    """
    x, at = start, evaluate(start)
    first = at.cost
    damping, growth = _DAMPING, 2.0
    for steps in range(most_steps):
        gain = expected_gain(at)
        if gain < tolerance:
            return Minimum(x, at, first, gain, steps, True)
        step = -Information(at.information).solved(at.gradient, damping)
        tried = evaluate(x + step)
        expected = -(2 * at.gradient + at.information @ step) @ step
        ratio = (at.cost - tried.cost) / expected
        if ratio > 0:
            x, at = x + step, tried
            damping, growth = damping * max(1 / 3, 1 - (2 * ratio - 1) ** 3), 2.0
        else:
            damping, growth = damping * growth, 2 * growth
            if damping > _MOST_DAMPING:
                break
    return Minimum(x, at, first, expected_gain(at), steps + 1, False)


def expected_gain(at: NormalEquations) -> float:
    """By how much an undamped step would lower the cost, to first order."""
    return float(at.gradient @ Information(at.information).solved(at.gradient))


_TOLERANCE = 1e-10
_MAX_STEPS = 256

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
        jacobian: J, the derivatives of the residuals.
        residuals: at the solution, in the residual function's unit.
    """

    parameters: Float[Array, "p"]
    covariance: Float[Array, "p p"]
    jacobian: Float[Array, "n p"]
    residuals: Float[Array, "n"]
    converged: bool | Array

    @property
    def information(self) -> Float[Array, "p p"]:
        """J^T J, whose inverse is the covariance if residuals are over their sigma."""
        return self.jacobian.T @ self.jacobian


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
    variance = jnp.sum(value**2) / (count - jacobian.shape[1])
    return Solution(
        parameters=result.value,
        covariance=variance * jnp.linalg.inv(jacobian.T @ jacobian),
        jacobian=jacobian,
        residuals=value,
        converged=result.result == optx.RESULTS.successful,
    )


def padded(values: Float[ArrayLike, "n ..."], length: int) -> Float[np.ndarray, "m ..."]:
    """Rows, the last one repeated up to a length: equal shapes share one compilation."""
    values = np.asarray(values)
    return np.pad(values, [(0, length - len(values)), *[(0, 0)] * (values.ndim - 1)], mode="edge")


_TUNING = 1.345
"""In standard deviations; 95 % as efficient as least squares for normal noise (Huber 1981)."""
_MAD_OF_NORMAL = 0.6745
_OUTLIER_SCORE = 3.5
"""Modified z-score from which Iglewicz and Hoaglin (1993) call a value an outlier."""


def huber(
    residual: Callable[[Float[Array, "p"]], Float[Array, "n"]],
    start: Float[ArrayLike, "p"],
    *,
    weight: Float[ArrayLike, "n"],
) -> tuple[Solution, Bool[Array, "n"]]:
    r"""Minimise Huber's loss by iteratively reweighted least squares.

    The scale is the median of the absolute residuals over 0.6745. Scale and parameters are a fixed
    point of the reweighting. The covariance is that of Huber (1981, eq. 6.5):
    $\kappa^2 \frac{\sum\psi^2/(n-p)}{(\overline{\psi'})^2} (J^T J)^{-1}$,
    $\kappa = 1 + \frac{p}{n}\frac{1 - \overline{\psi'}}{\overline{\psi'}}$.

    Args:
        residual: unweighted, almost linear function of the parameters; zero for padding.
        weight: 1, or 0 for padding.

    Returns:
        The solution, with unweighted residuals and Huber's covariance, and which residuals exceed
        3.5 robust standard deviations.
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
    spread, limit = scale(left), _TUNING * scale(left)
    within = jnp.sum(real & (jnp.abs(left) <= limit)) / count
    parameters = jacobian.shape[1]
    correction = 1.0 + parameters / count * (1.0 - within) / within
    variance = jnp.sum(jnp.clip(left, -limit, limit) ** 2) / (count - parameters)
    solution = Solution(
        parameters=found.value,
        covariance=correction**2 * variance / within**2 * jnp.linalg.inv(jacobian.T @ jacobian),
        jacobian=jacobian,
        residuals=left,
        converged=(found.result == optx.RESULTS.successful) & plain.converged,
    )
    return solution, (jnp.abs(left) > _OUTLIER_SCORE * spread) & (spread > 0)


def chance_alike(
    residuals: Float[np.ndarray, "n"],
    jacobian: Float[np.ndarray, "n p"],
    *,
    rows: Int[np.ndarray, "m"],
    columns: Sequence[int],
    degrees_of_freedom: int,
) -> float:
    """Probability of residuals as these if some parameters are the same in all of the data.

    Rao's score test (1948) of a model in which the parameters have other values in the `rows`: how
    much these would lower the sum of squares, and no other fit is needed. Beside what would then be
    left (F test), since residuals may be larger than their noise.

    Args:
        residuals: at the solution, over their standard deviations.
        columns: of the parameters.
    """
    other = np.zeros((len(residuals), len(columns)))
    other[rows] = jacobian[rows][:, columns]
    own = other - jacobian @ np.linalg.lstsq(jacobian, other)[0]
    step, _, count, _ = np.linalg.lstsq(own, residuals, rcond=1e-9)
    lower, left = (float(np.sum(np.square(part))) for part in (own @ step, residuals - own @ step))
    degrees = degrees_of_freedom - count
    return float(stats.f.sf((lower / count) / (left / degrees), count, degrees))


_MIN_COMPONENT = 0.1
"""Least component of a unit direction at which a parameter counts as part of it."""
_ALIKE_TOLERANCE = 0.2  # largest difference of two relative changes that count as equal
_LOST = 0.5
"""Information below which a direction counts as undetermined, in units of the parameter's size (or
of a nuisance's prior). Below it, the standard error exceeds the parameter itself."""

_REMEDIES = {
    "scale": "a trial in the eyeball, 3 mm or more from the axis",
    "eye_radius": "a trial in the eyeball, 3 mm or more from the axis",
    "inverse_working_distance": "trials at other places, 3 mm or more from the axis",
    "tilt_x": "trials on the plane at other places, 3 mm or more apart",
    "tilt_y": "trials on the plane at other places, 3 mm or more apart",
    "b": "touches that are known better",
    "half_angle": "frames at other distances",
}
"""Which data to add, by parameter; the first parameter that is part of a direction applies."""


def covariance_and_lost(
    information: Float[np.ndarray, "p p"],
    names: Sequence[str],
    values: Sequence[float] | None = None,
) -> tuple[Float[np.ndarray, "p p"], tuple[str, ...]]:
    """Covariance, and a sentence for each direction that the data do not determine.

    Args:
        information: Fisher information, priors included, of parameters in units of their size (for
            a nuisance, of its prior's sigma).
        values: values of the parameters, whose signs distinguish products from ratios; by default
            all are positive.

    Returns:
        The inverse, infinite for parameters that are part of an undetermined direction, and a
        sentence for each of these directions.
    """
    strength, directions = np.linalg.eigh(information)
    lost = strength < _LOST
    signs = np.ones(len(names)) if values is None else np.where(np.asarray(values) < 0, -1.0, 1.0)
    sentences = tuple(_sentence(direction, names, signs) for direction in directions.T[lost])
    inverse = np.where(lost, 0.0, 1.0 / np.where(lost, 1.0, strength))
    covariance = (directions * inverse) @ directions.T
    hidden = np.abs(directions[:, lost]).max(axis=1, initial=0.0) > _MIN_COMPONENT
    covariance[hidden, :] = covariance[:, hidden] = np.inf
    return covariance, sentences


def propagated(
    slopes: Float[np.ndarray, "n p"], covariance: Float[np.ndarray, "p p"]
) -> Float[np.ndarray, "n n"]:
    """Covariance of values by their derivatives; infinite if they follow an undetermined one."""
    lost = np.isinf(np.diag(covariance))
    result = np.asarray(slopes @ np.where(np.isinf(covariance), 0.0, covariance) @ slopes.T)
    hidden = slopes[:, lost].any(axis=1)
    result[hidden, :] = result[:, hidden] = np.inf
    return result


def _sentence(
    direction: Float[np.ndarray, "p"], names: Sequence[str], signs: Float[np.ndarray, "p"]
) -> str:
    # If only equal relative growth of two is undetermined, the data determine their ratio.
    parts = np.flatnonzero(np.abs(direction) > _MIN_COMPONENT).tolist()
    called = list(dict.fromkeys(names[i] for i in parts))
    both = " and ".join(called)
    growth = (direction * signs)[parts]
    if len(called) == 1:
        known = f"{both} is not determined"
    elif len(parts) == 2 and abs(growth[0] - growth[1]) < _ALIKE_TOLERANCE:
        known = f"only the ratio of {both} is determined"
    elif len(parts) == 2 and abs(growth[0] + growth[1]) < _ALIKE_TOLERANCE:
        known = f"only the product of {both} is determined"
    else:
        known = f"only a combination of {both} is determined"
    remedy = next((_REMEDIES[name] for name in _REMEDIES if name in called), "")
    trial = f"add {remedy}" if remedy else "add a trial in which they differ"
    return f"{known}: fix one, give a prior, or {trial}"
