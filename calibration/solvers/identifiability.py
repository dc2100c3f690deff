"""Which parameters data determine: the covariance, and in words the directions without one."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

_PART = 0.1  # of a unit direction, from which on a parameter has a part in it
_ALIKE = 0.2  # between the relative changes of two parameters that count as one
_LOST = 0.5
"""Information, in units of a parameter's own size (or of a nuisance's prior), below which a
direction counts as not seen: its standard error exceeds the parameter itself."""

_REMEDIES = {
    "scale": "a trial in the eyeball, 3 mm or more from the axis",
    "eye_radius": "a trial in the eyeball, 3 mm or more from the axis",
    "inverse_working_distance": "trials at other places, 3 mm or more from the axis",
    "tilt_x": "trials on the plane at other places, 3 mm or more apart",
    "tilt_y": "trials on the plane at other places, 3 mm or more apart",
    "b": "touches that are known better",
    "half_angle": "frames at other distances",
}
"""What to add, by parameter; the first one that has a part in a direction counts."""


def covariance_and_lost(
    information: Float[np.ndarray, "p p"],
    names: Sequence[str],
    values: Sequence[float] | None = None,
) -> tuple[Float[np.ndarray, "p p"], tuple[str, ...]]:
    """Covariance, and in words the directions in which there is none.

    Args:
        information: Fisher's, of parameters in units of their own size (of a nuisance: of its
            prior's sigma), priors included.
        names: of the parameters.
        values: of the parameters, whose signs tell products from ratios; all positive by default.

    Returns:
        The inverse, infinite where a parameter has a part in a lost direction, and a sentence for
        each of these.
    """
    strength, directions = np.linalg.eigh(information)
    lost = strength < _LOST
    signs = np.ones(len(names)) if values is None else np.where(np.asarray(values) < 0, -1.0, 1.0)
    told = tuple(_sentence(direction, names, signs) for direction in directions.T[lost])
    inverse = np.where(lost, 0.0, 1.0 / np.where(lost, 1.0, strength))
    covariance = (directions * inverse) @ directions.T
    hidden = np.abs(directions[:, lost]).max(axis=1, initial=0.0) > _PART
    covariance[hidden, :] = covariance[:, hidden] = np.inf
    return covariance, told


def marginal_information(
    information: Float[np.ndarray, "p p"], count: int
) -> Float[np.ndarray, "f f"]:
    """Fisher's information of the first `count` parameters where the others are unknown."""
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
    # Relative growth of each: two that grow alike without a trace show in their ratio alone.
    parts = np.flatnonzero(np.abs(direction) > _PART).tolist()
    called = list(dict.fromkeys(names[i] for i in parts))
    growth = (direction * signs)[parts]
    if len(called) == 1:
        seen = f"{called[0]} is not seen"
    elif len(parts) == 2 and abs(growth[0] - growth[1]) < _ALIKE:
        seen = f"{' and '.join(called)} only as their ratio"
    elif len(parts) == 2 and abs(growth[0] + growth[1]) < _ALIKE:
        seen = f"{' and '.join(called)} only as their product"
    else:
        seen = f"{' and '.join(called)} only together"
    remedy = next((_REMEDIES[name] for name in _REMEDIES if name in called), "")
    trial = f"add {remedy}" if remedy else "add a trial that tells them apart"
    return f"{seen}: fix one, give a prior, or {trial}"
