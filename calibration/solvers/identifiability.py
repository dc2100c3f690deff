"""Covariance, and the parameters that the data do not determine, in words."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

_PART = 0.1  # least component of a unit direction at which a parameter counts as part of it
_ALIKE = 0.2  # largest difference of two relative changes that count as equal
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
        names: names of the parameters.
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
    hidden = np.abs(directions[:, lost]).max(axis=1, initial=0.0) > _PART
    covariance[hidden, :] = covariance[:, hidden] = np.inf
    return covariance, sentences


def marginal_information(
    information: Float[np.ndarray, "p p"], count: int
) -> Float[np.ndarray, "f f"]:
    """Fisher information of the first `count` parameters, with the others unknown."""
    own, mixed = information[:count, :count], information[:count, count:]
    return own - mixed @ np.linalg.solve(information[count:, count:], mixed.T)


def correlations(covariance: Float[np.ndarray, "p p"]) -> Float[np.ndarray, "p p"]:
    """Correlation matrix; NaN where a variance is zero or infinite."""
    sigma = np.sqrt(np.diag(covariance))
    with np.errstate(invalid="ignore", divide="ignore"):
        return covariance / np.outer(sigma, sigma)


def _sentence(
    direction: Float[np.ndarray, "p"], names: Sequence[str], signs: Float[np.ndarray, "p"]
) -> str:
    # If only equal relative growth of two is undetermined, the data determine their ratio.
    parts = np.flatnonzero(np.abs(direction) > _PART).tolist()
    called = list(dict.fromkeys(names[i] for i in parts))
    both = " and ".join(called)
    growth = (direction * signs)[parts]
    if len(called) == 1:
        known = f"{both} is not determined"
    elif len(parts) == 2 and abs(growth[0] - growth[1]) < _ALIKE:
        known = f"only the ratio of {both} is determined"
    elif len(parts) == 2 and abs(growth[0] + growth[1]) < _ALIKE:
        known = f"only the product of {both} is determined"
    else:
        known = f"only a combination of {both} is determined"
    remedy = next((_REMEDIES[name] for name in _REMEDIES if name in called), "")
    trial = f"add {remedy}" if remedy else "add a trial in which they differ"
    return f"{known}: fix one, give a prior, or {trial}"
