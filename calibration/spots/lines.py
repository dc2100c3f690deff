"""The paper's line d_r = delta k e1' + b through many trials at once."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np


class Lines(NamedTuple):
    """What Table I lists of a trial, as arrays over trials (Zhou et al. 2020).

    Attributes:
        delta_k: mm/px, or k where spots are given in mm.
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
        semi_minor: ... x n, px or mm; NaN where no spot was found.
        reading: broadcasts against it, mm.

    Returns:
        Arrays of the shape ...; NaN where fewer than three spots, or spots of one size, are left.
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
