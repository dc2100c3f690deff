"""The wall's texture as a Gaussian process on a lattice of cells.

The logarithm of the reflectance has the covariance sum_j a_j k_j(h / l_j), h apart. The lengths l_j
are fixed, a factor of three to four apart. The variances a_j follow from the frames so far by
restricted maximum likelihood (Patterson and Thompson 1971), so that grain, vessels and slow shading
each have their share.

The grain is rough, with k = exp(-x). Vessels and shading are smooth in small, with the k of Matern
of the order 3/2 (Stein 1999). With rough ones the small cells tell more of the large ones than they
know: with all parts rough, a frame's light at its known pose is less likely by factors of 1e6 to
1e10 on drawn retinas, 3 to 2e5 on prints and up to 300 on a photograph.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.linalg import cholesky, solve_triangular
from scipy.optimize import minimize
from scipy.special import logsumexp

LENGTHS_MM = (0.08, 0.25, 1.0)
"""Correlation lengths of grain, vessels and shading: from a few pixels to the size of a spot."""
_USUAL = (0.02, 0.05, 0.07)
"""Standard deviations of the parts before a frame was seen, relative: the order of a retina's."""
_ANY, _ALIKE = 2.0 * math.log(30.0), 2.0 * math.log(10.0)
"""Standard deviations of a variance's logarithm before a frame was seen, of all parts together and
of each part by itself. Two thirds of all walls have a contrast within a factor of 30 of what is
usual, so that a sheet of paper is no surprise, and parts within a factor of ten of each other: a
print has no grain, and a photograph's grain is all that it has in small."""
_RANK = 1e-9  # of the largest derivative
_WITHIN = 0.52
"""Mean distance of two points of a square, over its side."""
_CONTRASTS = np.log(10.0) * np.arange(-5.0, 2.0)
"""Logarithms of all variances over the usual ones, from which the estimate starts."""
_NEAR = 0.1  # of the likeliest logarithms, or -2 log likelihoods: what the search stops at
_STEP = 0.5  # of a logarithm, for second differences
_NODES = np.linspace(-3.0, 3.0, 9)  # standard deviations, at which a mean is taken


@dataclass(frozen=True, eq=False)
class Texture:
    """Variances of the texture's parts.

    Attributes:
        variances: a_j, one for each of `LENGTHS_MM`.
    """

    variances: Float[np.ndarray, "parts"]

    @classmethod
    def usual(cls) -> Texture:
        """Before a frame was seen."""
        return cls(np.square(_USUAL))

    def covariance(self, count: int, side_mm: float) -> Float[np.ndarray, "n n"]:
        """Of the cells' means, for count x count cells of a side on the wall."""
        return np.tensordot(self.variances, _kernels(count, side_mm), axes=1)

    def variogram(self, apart_mm: Float[np.ndarray, "*n"] | float) -> Float[np.ndarray, "*n"]:
        """Variance of the difference of two points that are some way apart."""
        unlike = 1.0 - _alike(np.asarray(apart_mm))
        return np.asarray(2.0 * np.tensordot(self.variances, unlike, axes=1))

    @property
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
) -> Texture:
    """The texture that explains the residuals of cells.

    Args:
        residual: log light less its model, of count x count cells.
        weight: 1 over the variances of the residuals by the camera; 0 for cells that are not used.
        slopes: derivatives of the model by what was fitted to these residuals.
        count: cells along each side.
        side_mm: of a cell on the wall.
    """
    chosen = np.flatnonzero(weight > 0)
    kernels = _kernels(count, side_mm)[:, chosen[:, None], chosen]
    noise = np.diag(1.0 / weight[chosen])
    # Derivatives that are zero or sums of others would make the determinant zero.
    fitted, sizes, _ = np.linalg.svd(slopes[:, chosen].T, full_matrices=False)
    both = np.column_stack([fitted[:, sizes > _RANK * sizes[0]], residual[chosen]])
    precision = np.linalg.inv(_ANY**2 + _ALIKE**2 * np.eye(len(kernels)))

    def unlikelihood(off: Float[np.ndarray, "parts"]) -> float:
        """-2 log of the probability of variances, by their logarithms over the usual ones."""
        covariance = np.tensordot(np.square(_USUAL) * np.exp(off), kernels, axes=1) + noise
        factor = cholesky(covariance, lower=True, overwrite_a=True, check_finite=False)
        white = solve_triangular(factor, both, lower=True, check_finite=False)
        # The last column is what the fit leaves of the residual.
        sizes = np.log(np.abs(np.diag(np.linalg.qr(white, mode="r"))))
        determinants = np.sum(np.log(np.diag(factor))) + np.sum(sizes[:-1])
        return float(2.0 * determinants + np.exp(2.0 * sizes[-1]) + off @ precision @ off)

    parts = np.eye(len(kernels))
    start = min((contrast * parts.sum(axis=0) for contrast in _CONTRASTS), key=unlikelihood)
    near = {"initial_simplex": np.vstack([start, start + parts]), "xatol": _NEAR, "fatol": _NEAR}
    off = minimize(unlikelihood, start, method="Nelder-Mead", options=near).x
    return Texture(np.square(_USUAL) * _mean_exponential(unlikelihood, off))


def _mean_exponential(
    unlikelihood: Callable[[np.ndarray], float], likeliest: Float[np.ndarray, "n"]
) -> Float[np.ndarray, "n"]:
    """Mean of the exponentials of some numbers, by -2 log of their probability.

    Along the principal axes of the probability's curvature the numbers count as independent. They
    need not be normal: a wall may be as even as it likes, and one spot shows little of what is
    larger than it.
    """
    steps = _STEP * np.eye(len(likeliest))
    here = unlikelihood(likeliest)
    there = np.array([unlikelihood(likeliest + step) for step in steps])
    back = np.array([unlikelihood(likeliest - step) for step in steps])
    curvature = np.diag(there + back - 2.0 * here)
    for j, k in zip(*np.triu_indices(len(steps), 1), strict=True):
        both = unlikelihood(likeliest + steps[j] + steps[k])
        curvature[j, k] = curvature[k, j] = both - there[j] - there[k] + here
    precisions, axes = np.linalg.eigh(0.5 * curvature / _STEP**2)
    mean = np.exp(likeliest)
    for precision, axis in zip(precisions, axes.T, strict=True):
        ways = np.outer(_NODES / math.sqrt(max(precision, _ANY**-2)), axis)
        likely = -0.5 * np.array([unlikelihood(likeliest + way) for way in ways])
        mean *= np.exp(logsumexp(likely[:, None] + ways, axis=0) - logsumexp(likely))
    return mean


@functools.lru_cache(maxsize=4)
def _kernels(count: int, side_mm: float) -> Float[np.ndarray, "parts n n"]:
    place = np.arange(count)
    square = (place[:, None] - place) ** 2
    apart = np.add.outer(square, square).transpose(0, 2, 1, 3).reshape(count**2, count**2)
    # Means over cells vary less than points do: even those of one cell are some way apart.
    return _alike(side_mm * np.sqrt(apart + _WITHIN**2))


def _alike(apart_mm: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "parts *n"]:
    """Correlation of points that are some way apart, by each part."""
    grain, *smooth = LENGTHS_MM
    ways = [math.sqrt(3.0) * apart_mm / length for length in smooth]
    return np.stack([np.exp(-apart_mm / grain), *((1.0 + way) * np.exp(-way) for way in ways)])
