"""A blur of the image, on the cells of a lattice."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from estimator.pixels.cells import COUNT

_STEPS = np.eye(COUNT, k=1) + np.eye(COUNT, k=-1) - 2.0 * np.eye(COUNT)
_STEPS[[0, -1], [0, -1]] = -1.0  # beyond the lattice the light is as at its edge
_RATES, _WAVES = np.linalg.eigh(_STEPS)


def blurred(values: Float[np.ndarray, "*k n"], variance: float) -> Float[np.ndarray, "*k n"]:
    """Cells after a blur, as heat spreads on the lattice: it stays positive and has that variance.

    Args:
        values: of the cells.
        variance: of the blur along each side, in squares of a cell's side.
    """
    kernel = (_WAVES * np.exp(0.5 * variance * _RATES)) @ _WAVES.T
    grids = values.reshape(-1, COUNT, COUNT)
    return (kernel @ grids @ kernel).reshape(values.shape)


def growth_with_blur(values: Float[np.ndarray, "n"]) -> Float[np.ndarray, "n"]:
    """How blurred cells change with the variance."""
    grid = values.reshape(COUNT, COUNT)
    return 0.5 * (_STEPS @ grid + grid @ _STEPS).ravel()
