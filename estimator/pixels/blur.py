"""A blur of the image, on the cells of a lattice.

A blur has a variance and an excess kurtosis. A camera out of focus blurs by a disc, whose kurtosis
is -1; many small causes blur by a Gaussian, 0; a wall that scatters light sideways blurs by an
exponential, 2. Between these it is a mixture of the two, whose kurtosis is that of the mixture.
"""

from __future__ import annotations

import functools
import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.fft import dct
from scipy.special import j1

LEAST_KURTOSIS, MOST_KURTOSIS = -1.0, 2.0
"""Of a disc and of an exponential exp(-r/L)."""

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
        values: of the cells of a square lattice.
        variance: of the blur along each side, in squares of a cell's side.
        kurtosis: excess kurtosis of the blur.
    """
    lattice = _waves(math.isqrt(values.shape[-1]))
    transfer, _ = _transfer(lattice.squares, variance, kurtosis)
    return _filtered(values, lattice.waves, transfer)


def blurred_with_growth(
    values: Float[np.ndarray, "n"], variance: float, kurtosis: float
) -> Blurred:
    """As `blurred`, with the growth by the blur's two numbers."""
    lattice = _waves(math.isqrt(values.shape[-1]))
    transfer, by_kurtosis = _transfer(lattice.squares, variance, kurtosis)
    more, _ = _transfer(lattice.squares, variance + _STEP, kurtosis)
    parts = transfer, (more - transfer) / _STEP, by_kurtosis
    return Blurred(*(_filtered(values, lattice.waves, part) for part in parts))


class _Waves(NamedTuple):
    """Waves of a square lattice beyond which the light is mirrored.

    Attributes:
        waves: along a side, as columns.
        squares: of their numbers, those along both sides added, in 1 over squares of a cell's side.
    """

    waves: Float[np.ndarray, "count count"]
    squares: Float[np.ndarray, "count count"]


@functools.cache
def _waves(count: int) -> _Waves:
    numbers = np.pi * np.arange(count) / count
    waves = dct(np.eye(count), axis=0, norm="ortho").T
    return _Waves(waves, np.add.outer(numbers**2, numbers**2))


def _transfer(
    squares: np.ndarray, variance: float, kurtosis: float
) -> tuple[np.ndarray, np.ndarray]:
    """The blur's transfer function of the lattice's waves, and its growth with the kurtosis."""
    gaussian = np.exp(-0.5 * variance * squares)
    if kurtosis < 0:
        way = 2.0 * np.sqrt(variance * squares)  # a disc's variance is a quarter of its radius's
        other = np.where(way > _TINY, 2.0 * j1(way) / np.maximum(way, _TINY), 1.0)
        growth = (other - gaussian) / LEAST_KURTOSIS
    else:
        other = (1.0 + variance * squares / 3.0) ** -1.5
        growth = (other - gaussian) / MOST_KURTOSIS
    return gaussian + kurtosis * growth, growth


def _filtered(values: np.ndarray, waves: np.ndarray, transfer: np.ndarray) -> np.ndarray:
    grids = values.reshape(-1, *transfer.shape)
    return (waves @ (transfer * (waves.T @ grids @ waves)) @ waves.T).reshape(values.shape)
