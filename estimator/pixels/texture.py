"""How much does the reflectance of a wall vary, over which lengths?

The wall's texture is a Gaussian process: the logarithm of the reflectance has the covariance
sum_j a_j k_j(h / l_j), h apart. The lengths l_j are fixed, a factor of three to four apart. The
variances a_j follow from the frames so far by restricted maximum likelihood (Patterson and
Thompson 1971), so that grain, vessels and slow shading each have their share. The grain is rough,
with k = exp(-x). Vessels and shading are smooth in small, with the k of Matern of the order 3/2
(Stein 1999). With all parts rough, the small cells say more of the large ones than they know: a
frame's light at its known pose is less likely by factors of 1e6 to 1e10 on drawn retinas, 3 to
2e5 on prints and up to 300 on a photograph.
"""

import functools
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.linalg import cholesky, null_space, solve_triangular
from scipy.optimize import minimize
from scipy.special import logsumexp

from eyespot.optics.wall_light.unknown_wall import CONTRASTS, LENGTHS_MM, WITHIN

_ANY, _ALIKE = 2.0 * math.log(30.0), 2.0 * math.log(10.0)
"""Standard deviations of a variance's logarithm before a frame was seen, of all parts together and
of each part by itself. Two thirds of all walls have a contrast within a factor of 30 of what is
usual, so that a sheet of paper is expected, and parts within a factor of ten of each other: a
print has no grain, and a photograph's grain is all that it has in small."""
_ENOUGH = 400
"""Cells that show a texture: each part's variance to a tenth, where they see enough of it. The time
grows with the cube of their number."""
_RANK_TOLERANCE = 1e-9  # over the largest derivative
_STARTS = np.log(10.0) * np.arange(-5.0, 2.0)
"""Logarithms of all variances over the usual ones, from which the estimate starts."""
_SEARCH_TOLERANCE = 0.1  # of logarithms of variances, and of -2 log likelihoods
_LOG_STEP = 0.5  # of second differences by the logarithms
_QUADRATURE_SIGMAS = np.linspace(-3.0, 3.0, 9)  # standard deviations, at which a mean is taken


@dataclass(frozen=True, eq=False)
class TextureVariances:
    """Variances of the texture's parts.

    Attributes:
        variances: a_j, one for each of `LENGTHS_MM`.
    """

    variances: Float[np.ndarray, "parts"]

    @classmethod
    def usual(cls) -> "TextureVariances":
        """Before a frame was seen."""
        return cls(np.square(CONTRASTS))

    def covariance(self, count: int, side_mm: float) -> Float[np.ndarray, "n n"]:
        """Of the cells' means, for count x count cells of a side on the wall."""
        return np.tensordot(self.variances, _kernels(count, side_mm), axes=1)

    def variogram(self, apart_mm: Float[np.ndarray, "*n"] | float) -> Float[np.ndarray, "*n"]:
        """Variance of the difference of two points that are some way apart."""
        decorrelated = 1.0 - _alike(np.asarray(apart_mm))
        return np.asarray(2.0 * np.tensordot(self.variances, decorrelated, axes=1))

    @functools.cached_property
    def variance(self) -> float:
        """Of a point's log reflectance."""
        return float(np.sum(self.variances))


def texture_of(
    residual: Float[np.ndarray, "n"],
    weight: Float[np.ndarray, "n"],
    slopes: Float[np.ndarray, "p n"],
    *,
    count: int,
    side_mm: float,
) -> TextureVariances:
    """The texture that explains the residuals of cells.

    Args:
        residual: log light less its model, of count x count cells.
        weight: 1 over the variances of the residuals by the camera; 0 for cells that are not used.
        slopes: derivatives of the model by what was fitted to these residuals.
    """
    chosen = np.flatnonzero(weight > 0)
    chosen = chosen[:: math.ceil(chosen.size / _ENOUGH)]
    # What the fit leaves: its own directions say nothing of the texture.
    left = null_space(slopes[:, chosen], rcond=_RANK_TOLERANCE).T
    kernels = left @ _kernels(count, side_mm)[:, chosen[:, None], chosen] @ left.T
    noise, data = (left / weight[chosen]) @ left.T, left @ residual[chosen]
    precision = np.linalg.inv(_ANY**2 + _ALIKE**2 * np.eye(len(kernels)))

    def deviance(off: Float[np.ndarray, "parts"]) -> float:
        """-2 log of the probability of variances, by their logarithms over the usual ones."""
        covariance = np.tensordot(np.square(CONTRASTS) * np.exp(off), kernels, axes=1) + noise
        factor = cholesky(covariance, lower=True, overwrite_a=True, check_finite=False)
        white = solve_triangular(factor, data, lower=True, check_finite=False)
        return float(2.0 * np.sum(np.log(np.diag(factor))) + white @ white + off @ precision @ off)

    parts = np.eye(len(kernels))
    start = min((contrast * parts.sum(axis=0) for contrast in _STARTS), key=deviance)
    near = {
        "initial_simplex": np.vstack([start, start + parts]),
        "xatol": _SEARCH_TOLERANCE,
        "fatol": _SEARCH_TOLERANCE,
    }
    off = minimize(deviance, start, method="Nelder-Mead", options=near).x
    return TextureVariances(np.square(CONTRASTS) * _mean_exponential(deviance, off))


def _mean_exponential(
    deviance: Callable[[np.ndarray], float], likeliest: Float[np.ndarray, "n"]
) -> Float[np.ndarray, "n"]:
    """Mean of the exponentials of some numbers, by -2 log of their probability.

    Along the principal axes of the probability's curvature the numbers count as independent. They
    need not be normal: a wall may be as even as it likes, and one spot shows little of what is
    larger than it.
    """
    steps = _LOG_STEP * np.eye(len(likeliest))
    here = deviance(likeliest)
    there = np.array([deviance(likeliest + step) for step in steps])
    back = np.array([deviance(likeliest - step) for step in steps])
    curvature = np.diag(there + back - 2.0 * here)
    for j, k in zip(*np.triu_indices(len(steps), 1), strict=True):
        both = deviance(likeliest + steps[j] + steps[k])
        curvature[j, k] = curvature[k, j] = both - there[j] - there[k] + here
    precisions, axes = np.linalg.eigh(0.5 * curvature / _LOG_STEP**2)
    mean = np.exp(likeliest)
    for precision, axis in zip(precisions, axes.T, strict=True):
        steps = np.outer(_QUADRATURE_SIGMAS / math.sqrt(max(precision, _ANY**-2)), axis)
        log_weights = -0.5 * np.array([deviance(likeliest + step) for step in steps])
        mean *= np.exp(logsumexp(log_weights[:, None] + steps, axis=0) - logsumexp(log_weights))
    return mean


@functools.lru_cache(maxsize=4)
def _kernels(count: int, side_mm: float) -> Float[np.ndarray, "parts n n"]:
    place = np.arange(count)
    square = (place[:, None] - place) ** 2
    apart = np.add.outer(square, square).transpose(0, 2, 1, 3).reshape(count**2, count**2)
    # Means over cells vary less than points do: even those of one cell are some way apart.
    return _alike(side_mm * np.sqrt(apart + WITHIN**2))


def _alike(apart_mm: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "parts *n"]:
    """Correlation of points that are some way apart, by each part."""
    grain, *smooth = LENGTHS_MM
    steps = [math.sqrt(3.0) * apart_mm / length for length in smooth]
    return np.stack([np.exp(-apart_mm / grain), *((1.0 + step) * np.exp(-step) for step in steps)])
