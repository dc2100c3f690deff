"""Summaries of errors, and Shapley's fair shares of a whole.

NaN stands for a missing error and is left out; a summary is NaN if no error is there.
"""

import math
from collections.abc import Iterable

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike


def rms(errors: Iterable[float]) -> float:
    """Their root mean square."""
    return math.sqrt(pd.Series(errors, dtype=float).pow(2).mean())


def largest(errors: Iterable[float]) -> float:
    """The largest absolute value."""
    return float(pd.Series(errors, dtype=float).abs().max())


def first_reached(x: ArrayLike, size: ArrayLike, limit: float) -> float:
    """Least x at which a size reaches a limit, linear between the values; NaN if it never does."""
    x, size = np.asarray(x, float), np.asarray(size, float)
    reached = np.flatnonzero(size >= limit)
    if not reached.size:
        return math.nan
    around = slice(max(reached[0] - 1, 0), reached[0] + 1)
    return float(np.interp(limit, size[around], x[around]))


def coalitions(players: int) -> np.ndarray:
    """All sets of players, 2^n x n: True for members; row i has the bits of i."""
    return (np.arange(1 << players)[:, None] >> np.arange(players) & 1).astype(bool)


def shapley_values(worth: np.ndarray) -> np.ndarray:
    r"""Each player's mean gain over all orders in which players can join.

    $\phi_i = \sum_{S \not\ni i} \frac{|S|!\,(n - |S| - 1)!}{n!} (v(S \cup i) - v(S))$, the one
    division that gives all of v(everyone) - v(nobody), equal shares to equal players, nothing to
    those who change nothing, and adds up over sums of games (Shapley 1953).

    Args:
        worth: v of every coalition, ... x 2^n, in the order of `coalitions`.

    Returns:
        ... x n.
    """
    members = coalitions(int(worth.shape[-1]).bit_length() - 1)
    players = members.shape[1]
    size = members.sum(axis=1)
    orders = np.array([math.factorial(n) for n in range(players + 1)], float)
    joined = orders[size - 1] * orders[players - size] / orders[players]
    missing = orders[size] * orders[np.minimum(players - size - 1, players)] / orders[players]
    return np.asarray(worth @ np.where(members, joined[:, None], -missing[:, None]))
