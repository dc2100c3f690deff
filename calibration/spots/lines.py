"""The paper's line d_r = delta k e1' + b for many trials at once, without errors."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np


class Lines(NamedTuple):
    """The columns of Table I as arrays over trials (Zhou et al. 2020).

    Attributes:
        delta_k: mm/px, or k if the spots are given in mm.
        b: mm.
        r_squared: coefficient of determination.
        rmse: root mean square error, mm.
    """

    delta_k: np.ndarray
    b: np.ndarray
    r_squared: np.ndarray
    rmse: np.ndarray


def fit_lines(semi_minor: np.ndarray, reading: np.ndarray) -> Lines:
    """Least squares of d_r on e1': the same line as `fit_plane`, without standard errors.

    Args:
        semi_minor: e1', ... x n, px or mm; NaN for frames without a spot.
        reading: d_r, mm; broadcasts against `semi_minor`.

    Returns:
        Arrays of the shape ...; NaN for trials with fewer than three spots, or with equal sizes.
    """
    seen = np.isfinite(semi_minor)
    count = np.count_nonzero(seen, axis=-1)
    reading = np.where(seen, reading, 0.0)
    with np.errstate(invalid="ignore", divide="ignore"):

        def mean(values: np.ndarray) -> np.ndarray:
            return np.asarray(np.sum(values, axis=-1) / count)

        axis = np.where(seen, semi_minor, 0.0)
        mean_axis, mean_reading = mean(axis), mean(reading)
        axis = np.where(seen, axis - mean_axis[..., None], 0.0)
        offset = np.where(seen, reading - mean_reading[..., None], 0.0)
        delta_k = mean(axis * offset) / mean(axis**2)
        squares = mean((offset - delta_k[..., None] * axis) ** 2)
        line = Lines(
            delta_k=delta_k,
            b=mean_reading - delta_k * mean_axis,
            r_squared=1.0 - squares / mean(offset**2),
            rmse=np.sqrt(squares),
        )
    return Lines(*(np.where(count >= 3, value, np.nan) for value in line))
