"""Rows of pose_error.csv, how priors are drawn, and what many rows amount to."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

import optics

PRIOR_DEG = 5.0
"""Standard deviation of the direction prior across the axis: a robot's, roughly known."""

_MIRRORED_DEG = 2.0
"""An axis farther off than this, and by more than half of the way to the mirror, is mirrored."""

FREE, PRIOR, KNOWN = "none", "5 deg", "axis known"
NAMES = {1: "one spot", 3: "three spots"}

REPORTED = {1: (0.029, 0.124), 3: (0.025, 0.101)}
"""Mean errors of tip (mm) and axis (degrees) by number of spots: Zhou et al., "Theoretical error
analysis of spotlight-based instrument localization for retinal surgery", Robotica 2023; rendered
in Blender, with a light and an eye of their own."""

ASKED_TIP_MM, ASKED_AXIS_DEG, ASKED_DISTANCE_MM = 0.010, 0.1, 0.005
"""Root mean square errors that rendered spots shall not exceed."""


class PoseError(NamedTuple):
    """Row of pose_error.csv; errors are estimate - truth, or lengths and angles between the two.

    `prior` of the direction: "none", "5 deg", or "axis known"; `mirrored`: the solution with the
    incidence reversed was taken; bounds are Cramer and Rao's standard deviations of the same
    quantities, for the noise of the row; `sigma_distance_mm` is what the estimator says itself.
    """

    source: str
    spots: int
    prior: str
    z_f_mm: float
    c_mm: float
    d_mm: float
    incidence_deg: float
    azimuth_deg: float
    noise_px: float
    mirrored: bool
    tip_error_mm: float
    axis_error_deg: float
    distance_error_mm: float
    tip_bound_mm: float
    axis_bound_deg: float
    sigma_distance_mm: float


class Scatter(NamedTuple):
    """What rows amount to.

    Attributes:
        poses: how many.
        mirrored: share of them with the mirrored solution.
        tip_mm: root mean square error of the tip, of those that are not mirrored.
        tip_mean_mm: mean error of the tip, likewise.
        tip_all_mm: root mean square error of the tip, mirrored solutions included.
        axis_deg: root mean square error of the axis, of those that are not mirrored.
        axis_mean_deg: mean error of the axis, likewise.
        distance_mm: root mean square error of the distance, of all.
        tip_bound_mm: root mean square of the bounds; axis_bound_deg likewise.
    """

    poses: int
    mirrored: float
    tip_mm: float
    tip_mean_mm: float
    tip_all_mm: float
    axis_deg: float
    axis_mean_deg: float
    distance_mm: float
    tip_bound_mm: float
    axis_bound_deg: float


def scatter(rows: Sequence[PoseError]) -> Scatter:
    """Root mean squares and means over rows."""
    right = [row for row in rows if not row.mirrored]
    return Scatter(
        poses=len(rows),
        mirrored=1.0 - len(right) / len(rows) if rows else math.nan,
        tip_mm=rms([row.tip_error_mm for row in right]),
        tip_mean_mm=_mean([row.tip_error_mm for row in right]),
        tip_all_mm=rms([row.tip_error_mm for row in rows]),
        axis_deg=rms([row.axis_error_deg for row in right]),
        axis_mean_deg=_mean([row.axis_error_deg for row in right]),
        distance_mm=rms([row.distance_error_mm for row in rows]),
        tip_bound_mm=rms([row.tip_bound_mm for row in right]),
        axis_bound_deg=rms([row.axis_bound_deg for row in right]),
    )


def rms(values: Sequence[float]) -> float:
    """Root mean square; NaN of nothing."""
    return float(np.sqrt(np.mean(np.square(values)))) if len(values) else math.nan


def drawn_prior(axis: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """A direction that is off by `PRIOR_DEG` (standard deviation) along each perpendicular."""
    first, second = (np.asarray(v) for v in optics.perpendicular_frame(axis))
    off = np.radians(PRIOR_DEG) * rng.standard_normal(2)
    turned = axis + off[0] * first + off[1] * second
    return turned / np.linalg.norm(turned)


def angle_deg(axis: np.ndarray, other: np.ndarray) -> float:
    """Between unit vectors, exact for small ones too."""
    sine = np.linalg.norm(np.cross(axis, other))
    return math.degrees(math.atan2(sine, float(np.dot(axis, other))))


def is_mirrored(found: np.ndarray, true: np.ndarray, outward: np.ndarray) -> bool:
    """Whether an axis is nearer to the true one's mirror image at the wall than to the true one."""
    mirror = 2.0 * np.dot(outward, true) * outward - true
    off = angle_deg(found, true)
    return off > _MIRRORED_DEG and angle_deg(found, mirror) < off


def _mean(values: Sequence[float]) -> float:
    return float(np.mean(values)) if len(values) else math.nan


def some_of(rows: Sequence[PoseError], source: str, spots: int, prior: str) -> list[PoseError]:
    """The rows of one source, number of spots and prior."""
    return [r for r in rows if (r.source, r.spots, r.prior) == (source, spots, prior)]
