"""What Zhou et al. 2020 report, as printed: Tables I and II."""

from __future__ import annotations

from typing import NamedTuple


class PlaneRow(NamedTuple):
    """Row of Table I; mm."""

    delta_k: float
    b: float
    r_squared: float
    rmse: float


class SphereRow(NamedTuple):
    """Row of Table II; mm."""

    c: float
    standard_deviation: float
    mean_absolute_error: float
    max_error: float


ALL_PLANES = "all planes"
"""The row of Table I for all its trials together."""

TABLE_I = {
    "plane 1": PlaneRow(0.1496, -6.791, 0.9959, 0.0548),
    "plane 2": PlaneRow(0.1343, -5.069, 0.9909, 0.0974),
    "plane 3": PlaneRow(0.1347, -5.226, 0.9961, 0.0663),
    ALL_PLANES: PlaneRow(0.1321, -5.117, 0.9703, 0.1630),
}

TABLE_II = {
    "sphere 1": SphereRow(5.531, 0.064, 0.146, 0.328),
    "sphere 2": SphereRow(6.982, 0.097, 0.140, 0.372),
    "sphere 3": SphereRow(4.584, 0.088, 0.160, 0.396),
}

ACCEPTABLE_ERROR_MM = 0.5
"""The error that the paper calls acceptable."""

PAPERS_PLANES = {name: row for name, row in TABLE_I.items() if name != ALL_PLANES}
"""The rows of Table I for single trials."""
