"""Levenberg-Marquardt on J^T J and J^T r, without a Jacobian in memory.

Optimistix and SciPy need the residuals or their Jacobian, which takes 24 GB for the pixels of 40
frames. The sums over pixels used here can be computed in chunks.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

MOST_STEPS = 40
_DAMPING, _MOST_DAMPING = 1e-6, 1e8
_RIDGE, _NOTHING = 1e-12, 1e-300  # of a parameter's information


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
        x: parameters.
        at: the normal equations there.
        first: cost at the start.
        gain: by how much another step would lower the cost, to first order.
        steps: number of evaluations after the first.
        converged: whether the gain is less than the tolerance.
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

    Args:
        evaluate: function that returns the normal equations at a point.
        start: first guess.
        tolerance: tolerance of the cost.
        most_steps: evaluations after which it ends anyway.
    """
    x, at = start, evaluate(start)
    first = at.cost
    damping, growth = _DAMPING, 2.0
    for steps in range(most_steps):
        gain = expected_gain(at)
        if gain < tolerance:
            return Minimum(x, at, first, gain, steps, True)
        damped = at.information + damping * np.diag(np.diag(at.information))
        step = -_solved(damped, at.gradient)
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
    return float(at.gradient @ _solved(at.information, at.gradient))


def _solved(
    information: Float[np.ndarray, "p p"], gradient: Float[np.ndarray, "p"]
) -> Float[np.ndarray, "p"]:
    """A^-1 g; directions that the residuals do not determine stay as they are."""
    size = np.sqrt(np.maximum(np.diag(information), _NOTHING))
    scaled = information / np.outer(size, size)
    scaled[np.diag_indices_from(scaled)] += _RIDGE
    return np.asarray(np.linalg.solve(scaled, gradient / size) / size)
