"""A blur of the image, on the cells of a lattice.

A blur has a variance and an excess kurtosis. A camera out of focus blurs by a disc, whose kurtosis
is -1; many small causes blur by a Gaussian, 0; a wall that scatters light sideways blurs by an
exponential, 2. Between these it is a mixture of the two, whose kurtosis is that of the mixture.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.fft import dct
from scipy.special import j1

from estimator.pixels.cells import COUNT

LEAST_KURTOSIS, MOST_KURTOSIS = -1.0, 2.0
"""Of a disc and of an exponential exp(-r/L)."""

_WAVES = dct(np.eye(COUNT), axis=0, norm="ortho").T
"""Columns: the waves of a lattice beyond which the light is mirrored."""
_SQUARES = np.add.outer(*2 * [(np.pi * np.arange(COUNT) / COUNT) ** 2])
"""Squares of the waves' numbers, in 1 over squares of a cell's side."""
_TINY = 1e-9
_STEP = 1e-4  # of the numerical derivative by the variance


class Blurred(NamedTuple):
    """Cells after a blur.

    Attributes:
        value: of the cells.
        by_variance: their growth with the variance, in squares of a cell's side.
        by_kurtosis: their growth with the kurtosis.
    """

    value: Float[np.ndarray, "n"]
    by_variance: Float[np.ndarray, "n"]
    by_kurtosis: Float[np.ndarray, "n"]


def blurred(
    values: Float[np.ndarray, "*k n"], variance: float, kurtosis: float = 0.0
) -> Float[np.ndarray, "*k n"]:
    """Cells after a blur that spreads from cell to cell.

    Args:
        values: of the cells.
        variance: of the blur along each side, in squares of a cell's side.
        kurtosis: excess kurtosis of the blur.
    """
    waves, _ = _transfer(variance, kurtosis)
    return _filtered(values, waves)


def blurred_with_growth(
    values: Float[np.ndarray, "n"], variance: float, kurtosis: float
) -> Blurred:
    """As `blurred`, with the growth by the blur's two numbers."""
    waves, by_kurtosis = _transfer(variance, kurtosis)
    more, _ = _transfer(variance + _STEP, kurtosis)
    return Blurred(
        *(_filtered(values, part) for part in (waves, (more - waves) / _STEP, by_kurtosis))
    )


def _transfer(variance: float, kurtosis: float) -> tuple[np.ndarray, np.ndarray]:
    """The blur's transfer function of the lattice's waves, and its growth with the kurtosis."""
    gaussian = np.exp(-0.5 * variance * _SQUARES)
    if kurtosis < 0:
        way = 2.0 * np.sqrt(variance * _SQUARES)  # a disc's variance is a quarter of its radius's
        other = np.where(way > _TINY, 2.0 * j1(way) / np.maximum(way, _TINY), 1.0)
        growth = (other - gaussian) / LEAST_KURTOSIS
    else:
        other = (1.0 + variance * _SQUARES / 3.0) ** -1.5
        growth = (other - gaussian) / MOST_KURTOSIS
    return gaussian + kurtosis * growth, growth


def _filtered(values: np.ndarray, transfer: np.ndarray) -> np.ndarray:
    grids = values.reshape(-1, COUNT, COUNT)
    return (_WAVES @ (transfer * (_WAVES.T @ grids @ _WAVES)) @ _WAVES.T).reshape(values.shape)
