"""The results as data: tracked trials, fits, model errors, and the rows of the CSV files."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, NamedTuple

from benchmarks.evaluation import ModelError, StaticTrial, Tracked
from benchmarks.reporting import Column
from calibration import PlaneFit, SphereFit

CHOSEN_ECCENTRICITIES_MM = (3.0, 5.0)
"""Eccentricities at which the report gives the model errors."""


@dataclass(frozen=True, kw_only=True)
class ValidateFindings:
    """All results of a run.

    Attributes:
        stacks: folder of the rendered stacks.
        trials: all trials in order.
        tracked: by (trial name, way of measuring).
        plane_fits: by (source, way), then by "plane 1" … and "all planes".
        sphere_fits: by (source, way), then by "sphere 1" …
        analytic: model errors on exact contours.
        rendered: model errors on measured spots of the ideal cone.
    """

    stacks: Path
    trials: list[StaticTrial]
    tracked: dict[tuple[str, str], Tracked]
    plane_fits: dict[tuple[str, str], dict[str, PlaneFit]]
    sphere_fits: dict[tuple[str, str], dict[str, SphereFit]]
    analytic: list[ModelError]
    rendered: list[ModelError]

    def planes(self, source: str) -> list[StaticTrial]:
        """The trials of a source on the plane."""
        return [t for t in self.trials if (t.source, t.kind) == (source, "plane")]

    @property
    def sources(self) -> list[str]:
        """The sources of the paper's trials."""
        return list(dict.fromkeys(t.source for t in self.trials if t.kind != "grid"))


class PlaneFitRow(NamedTuple):
    """Row of table_1.csv: a fit of delta k and b, and the paper's values."""

    source: Annotated[str, Column("source")]
    way: Annotated[str, Column("way")]
    trial: Annotated[str, Column("trial")]
    delta_k_mm_px: Annotated[float, Column("δk, mm/px", 4)]
    delta_k_error_mm_px: Annotated[float, Column("±", 4)]
    paper_delta_k_mm_px: Annotated[float, Column("paper", 4)]
    b_mm: Annotated[float, Column("b, mm")]
    b_error_mm: Annotated[float, Column("±")]
    paper_b_mm: Annotated[float, Column("paper")]
    r_squared: Annotated[float, Column("R²", 4)]
    paper_r_squared: Annotated[float, Column("paper", 4)]
    rmse_mm: Annotated[float, Column("RMSE, mm", 4)]
    paper_rmse_mm: Annotated[float, Column("paper", 4)]
    contact_radius_px: Annotated[float, Column("−b/δk, px", 1)]
    spots: Annotated[int, Column("spots")]
    converged: Annotated[bool, Column("converged")]


class SphereFitRow(NamedTuple):
    """Row of table_2.csv: a fit of c, the true c and the paper's values.

    `c_expected_mm` is the c whose factor cos(phi) equals the correct factor of the true c.
    """

    source: Annotated[str, Column("source")]
    way: Annotated[str, Column("way")]
    trial: Annotated[str, Column("trial")]
    c_true_mm: Annotated[float, Column("true c, mm")]
    c_fitted_mm: Annotated[float, Column("fitted c, mm")]
    c_error_mm: Annotated[float, Column("±")]
    c_expected_mm: Annotated[float, Column("expected")]
    standard_deviation_mm: Annotated[float, Column("SD, mm", 4)]
    paper_standard_deviation_mm: Annotated[float, Column("paper")]
    mean_absolute_error_mm: Annotated[float, Column("mean |error|, mm", 4)]
    paper_mean_absolute_error_mm: Annotated[float, Column("paper")]
    max_error_mm: Annotated[float, Column("max |error|, mm", 4)]
    paper_max_error_mm: Annotated[float, Column("paper")]
    spots: Annotated[int, Column("spots")]
    converged: Annotated[bool, Column("converged")]
    at_bound: Annotated[bool, Column("at the bound")]


class SpotRow(NamedTuple):
    """Row of spots.csv: truth and measurement of one frame in one way.

    `estimate_mm` comes from the fit that used the frame. It is zero at contact, like d_r.
    """

    trial: str
    source: str
    group: str
    way: str
    frame: int
    file_name: str
    c_mm: float
    d_mm: float
    d_r_mm: float
    visible_fraction: float
    saturated_fraction: float
    outcome: str
    measured_px: float
    half_max_px: float
    cone_px: float
    estimate_mm: float
    residual_mm: float


class FrameRow(NamedTuple):
    """Row of frames.csv: number of a trial's frames with one outcome in one way."""

    trial: Annotated[str, Column("trial")]
    source: str
    way: Annotated[str, Column("way")]
    outcome: Annotated[str, Column("outcome")]
    frames: Annotated[int, Column("frames")]
