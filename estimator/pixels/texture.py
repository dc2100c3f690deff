"""The wall's texture as a Gaussian process on a lattice of cells.

The logarithm of the reflectance has the covariance sum_j a_j exp(-h/l_j), h apart. The lengths l_j
are fixed, a factor of four apart. The variances a_j follow from the first frames by restricted
maximum likelihood (Patterson and Thompson 1971), so that vessels, grain and slow shading each have
their share.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.linalg import cho_factor, cho_solve

LENGTHS_MM = (0.08, 0.32, 1.28)
"""Correlation lengths: from a few pixels to the size of a spot."""
_USUAL = (0.04, 0.06, 0.06)
"""Standard deviations of the parts before a frame was seen, relative: the order of a retina's."""
_FACTOR = 3.0
"""Within this factor of what is usual are two thirds of all walls: the prior is log-normal, so that
a wall may also be quite even."""
_SPREAD = 2.0 * math.log(_FACTOR)  # standard deviation of a variance's logarithm
_LEAST = 1e-3  # standard deviation, relative; a wall that is quite even has no inverse
_WITHIN = 0.52
"""Mean distance of two points of a square, over its side."""
_STEPS = 12  # of the estimate; each brings it nearer by a factor of about three


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

    @property
    def roughness(self) -> float:
        """Slope of the variogram at 0, 1/mm: variance of the difference of two near points."""
        return float(2.0 * np.sum(self.variances / np.array(LENGTHS_MM)))

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
    """The texture that explains the residuals of a frame's cells.

    Args:
        residual: log light less its model, of count x count cells.
        weight: 1 over the variances of the residuals by the camera; 0 for cells that are not used.
        slopes: derivatives of the model by what was fitted to these residuals.
        count: cells along each side.
        side_mm: of a cell on the wall.
    """
    chosen = np.flatnonzero(weight > 0)
    kernels = _kernels(count, side_mm)[:, chosen[:, None], chosen]
    residual, noise, fitted = residual[chosen], 1.0 / weight[chosen], slopes[:, chosen].T
    usual = np.square(_USUAL)
    variances = usual.copy()
    for _ in range(_STEPS):
        covariance = np.tensordot(variances, kernels, axes=1) + np.diag(noise)
        inverse = cho_solve(cho_factor(covariance, lower=True), np.eye(len(residual)))
        weighted = inverse @ fitted
        projected = inverse - weighted @ np.linalg.pinv(fitted.T @ weighted) @ weighted.T
        own = projected @ residual
        found = np.einsum("i,jik,k->j", own, kernels, own, optimize=True)
        expected = np.einsum("ik,jik->j", projected, kernels, optimize=True)
        # Steps of a majorising function (Zhou et al. 2019), with the prior's share.
        excess = 2.0 * np.log(variances / usual) / _SPREAD**2 / variances
        found += np.maximum(-excess, 0.0)
        expected += np.maximum(excess, 0.0)
        variances = np.maximum(variances * np.sqrt(found / expected), _LEAST**2)
    # One spot shows little of the long parts. Of all variances that it allows the mean counts:
    # given the others, each is nearly log-normal, with this precision.
    parts = projected @ kernels
    precision = 0.5 * np.square(variances) * np.einsum("jik,jki->j", parts, parts, optimize=True)
    precision += _SPREAD**-2
    return Texture(variances * np.exp(0.5 / precision))


@functools.lru_cache(maxsize=4)
def _kernels(count: int, side_mm: float) -> Float[np.ndarray, "parts n n"]:
    place = np.arange(count)
    square = (place[:, None] - place) ** 2
    apart = np.add.outer(square, square).transpose(0, 2, 1, 3).reshape(count**2, count**2)
    # Means over cells vary less than points do: even those of one cell are some way apart.
    distance = side_mm * np.sqrt(apart + _WITHIN**2)
    return np.stack([np.exp(-distance / length) for length in LENGTHS_MM])
