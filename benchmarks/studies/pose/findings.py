"""The results as data: the error of every pose, and summaries."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Annotated, NamedTuple

from benchmarks.evaluation import mean, rms
from benchmarks.reporting import Column
from scenes import Scene

HALF_WIDTH_MM = 5.0
"""Half the side of the square around the microscope's axis in which O lies: 10 mm x 10 mm."""
NEAREST_MM, FARTHEST_MM = 0.5, 5.5
"""Distances from tip to wall along the beam: 5 mm of depth."""
INCIDENCE_DEG = (10.0, 30.0)
NOISE_PX = 0.05
"""Standard deviation across the contour of each of 128 points."""
LARGEST_C_MM = 5.0
"""Largest eccentricity of the rendered spots."""
PRIOR_DEG = 5.0
"""Standard deviation of the direction prior across the axis, as for a rough robot calibration."""

SOURCES = ("analytic", "rendered")
NAMES = {1: "one spot", 3: "three spots"}

REPORTED = {1: (0.029, 0.124), 3: (0.025, 0.101)}
"""Mean errors of tip (mm) and axis (degrees) by number of spots: Zhou et al., "Theoretical error
analysis of spotlight-based instrument localization for retinal surgery", Robotica 2023; rendered
in Blender, with another light and eye."""

REQUIRED_TIP_MM, REQUIRED_AXIS_DEG, REQUIRED_DISTANCE_MM = 0.010, 0.1, 0.005
"""Required root mean square errors of rendered spots."""


class Prior(StrEnum):
    """Prior knowledge of the axis."""

    ROUGH = "5 deg"
    NONE = "none"
    KNOWN = "axis known"

    @property
    def sigma_rad(self) -> float:
        """The solver's standard deviation of the prior across the axis, rad."""
        return {Prior.ROUGH: math.radians(PRIOR_DEG), Prior.NONE: 1e6, Prior.KNOWN: 1e-6}[self]


class PoseError(NamedTuple):
    """Row of pose_error.csv; errors are estimate - truth, or lengths and angles between the two.

    `mirrored`: whether the solution has the reversed incidence. The bounds are the Cramér-Rao
    standard deviations of the same quantities for the row's noise. `sigma_distance_mm` is the
    standard deviation that the estimator reports.
    """

    source: str
    spots: int
    prior: Prior
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
    """A summary of rows that share source, number of spots, prior and pinhole.

    The errors of tip and axis exclude mirrored solutions; `tip_all_mm` and `distance_mm` include
    them.
    """

    source: Annotated[str, Column("source")]
    spots: Annotated[int, Column("spots")]
    prior: Annotated[str, Column("prior")]
    z_f_mm: Annotated[float, Column("z_F, mm", 1)]
    poses: Annotated[int, Column("poses")]
    mirrored: Annotated[float, Column("mirrored, %", 1, scale=100)]
    tip_mm: Annotated[float, Column("tip, µm", scale=1e3)]
    tip_mean_mm: Annotated[float, Column("mean, µm", scale=1e3)]
    tip_bound_mm: Annotated[float, Column("bound, µm", scale=1e3)]
    tip_all_mm: Annotated[float, Column("tip with mirrored, µm", scale=1e3)]
    axis_deg: Annotated[float, Column("axis, °")]
    axis_mean_deg: Annotated[float, Column("mean, °")]
    axis_bound_deg: Annotated[float, Column("bound, °")]
    distance_mm: Annotated[float, Column("distance, µm", scale=1e3)]
    sigma_distance_mm: Annotated[float, Column("its σ, µm", scale=1e3)]


def scatter(rows: Sequence[PoseError]) -> Scatter:
    """Root mean squares and means; rows that share a source, number of spots and prior."""
    right = [row for row in rows if not row.mirrored]
    heights = {row.z_f_mm for row in rows}
    return Scatter(
        source=rows[0].source,
        spots=rows[0].spots,
        prior=rows[0].prior,
        z_f_mm=heights.pop() if len(heights) == 1 else math.nan,
        poses=len(rows),
        mirrored=1.0 - len(right) / len(rows),
        tip_mm=rms(row.tip_error_mm for row in right),
        tip_mean_mm=mean(row.tip_error_mm for row in right),
        tip_bound_mm=rms(row.tip_bound_mm for row in right),
        tip_all_mm=rms(row.tip_error_mm for row in rows),
        axis_deg=rms(row.axis_error_deg for row in right),
        axis_mean_deg=mean(row.axis_error_deg for row in right),
        axis_bound_deg=rms(row.axis_bound_deg for row in right),
        distance_mm=rms(row.distance_error_mm for row in rows),
        sigma_distance_mm=rms(row.sigma_distance_mm for row in rows),
    )


@dataclass(frozen=True, kw_only=True)
class PoseFindings:
    """All results of a run.

    Attributes:
        scene: the study's.
        rows: errors of all poses.
    """

    scene: Scene
    rows: list[PoseError]

    def some(self, source: str, spots: int, prior: Prior) -> list[PoseError]:
        """The rows of one source, number of spots and prior."""
        return [r for r in self.rows if (r.source, r.spots, r.prior) == (source, spots, prior)]

    def scatters(self, *priors: Prior) -> Iterator[Scatter]:
        """Summaries by prior, source, number of spots and pinhole."""
        for prior in priors:
            for source in SOURCES:
                for spots in REPORTED:
                    rows = self.some(source, spots, prior)
                    for height in dict.fromkeys(row.z_f_mm for row in rows):
                        yield scatter([row for row in rows if row.z_f_mm == height])
