"""What the study of eccentricity finds: errors of the models, where they exceed limits, and why."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, NamedTuple

from benchmarks.evaluation import MICROSCOPE_MM, ModelError
from benchmarks.reporting import Column
from scenes import Scene

LARGEST_C_MM = 8.0
"""End of the axis c of every part."""

SHOWN_C_MM = 4.0
"""Where the report splits the error."""

LIMITS_MM = (0.1, 0.5)
"""Errors whose crossing is reported; the paper calls 0.5 mm acceptable."""

DISTANCES_MM = tuple(0.5 * n for n in range(1, 13))
"""Of one withdrawal, 0.5 to 6 mm."""


class Limit(NamedTuple):
    """Row of limits.csv: the smallest c at which the largest error over all d reaches the limit.

    `c_mm` is empty if the limit is not reached up to the largest c; 0 if it is exceeded from the
    start.
    """

    model: str
    refit: bool
    z_f_mm: float
    incidence_deg: float
    limit_mm: float
    c_mm: float


class Refit(NamedTuple):
    """Row of refit.csv: c fitted to one withdrawal, and the error before and after.

    `hidden_mm` is the part of the largest error that the fitted c takes away.
    """

    source: str
    z_f_mm: Annotated[float, Column("z_F, mm", 1)]
    incidence_deg: float
    c_mm: Annotated[float, Column("true c, mm", 0)]
    fitted_c_mm: Annotated[float, Column("fitted c, mm")]
    at_bound: bool
    largest_error_mm: Annotated[float, Column("error, mm")]
    largest_residual_mm: Annotated[float, Column("residual, mm")]
    hidden_mm: Annotated[float, Column("hidden, mm")]


class Withdrawals(NamedTuple):
    """Errors over a grid of c and d for one pinhole and incidence.

    Attributes:
        errors: of all models with the true c, then of small_plane with the fitted one.
        refits: a fit for each c.
    """

    errors: list[ModelError]
    refits: list[Refit]


class CauseShare(NamedTuple):
    """Row of causes.csv: what one cause adds to a model's error.

    `whole_mm` is the error with all causes, to which the parts of a geometry sum.
    """

    model: str
    cause: str
    medium: str
    c_mm: float
    d_mm: float
    r_mm: float
    z_f_mm: float
    incidence_deg: float
    azimuth_deg: float
    half_angle_deg: float
    apex_offset_mm: float
    part_mm: float
    whole_mm: float


AXES = {
    "c_mm": (0.0, 8.0),
    "d_mm": (0.5, 6.0),
    "r_mm": (10.5, 12.5),
    "incidence_deg": (0.0, 45.0),
    "azimuth_deg": (0.0, 360.0),
    "half_angle_deg": (2.0, 8.0),
}
"""What is varied continuously, and its range; columns of model_error.csv."""

PINHOLES = ("centre", "sphere", "200", "inf")
"""z_F: the eyeball's centre (0), on the sphere (r), 200 mm, telecentric."""


class BinSpread(NamedTuple):
    """Row of space.csv: the size of a model's error in one bin of one axis, over all others."""

    model: str
    pinhole: str
    axis: str
    from_value: float
    to_value: float
    geometries: int
    median_mm: float
    percentile_95_mm: float


class Sensitivity(NamedTuple):
    """Row of sensitivity.csv: part of a model's error variance that one axis alone explains.

    The first-order Sobol index (Sobol 1993), in [0, 1]; the axes' sum is short of 1 by the part of
    axes together.
    """

    model: str
    pinhole: str
    axis: str
    first_order: float


class RenderedErrors(NamedTuple):
    """What the rendered part found.

    Attributes:
        errors: of all models on every measured spot, and of small_plane with c fitted.
        refits: a fit for each trial with enough spots.
        shares: the errors by cause, for trials with a noise-free frame.
        frames: rendered for the errors.
        left_out: number of them without a spot that counts.
    """

    errors: list[ModelError]
    refits: list[Refit]
    shares: list[CauseShare]
    frames: int
    left_out: int

    @property
    def with_true_c(self) -> list[ModelError]:
        """The errors without those of a fitted c."""
        return [e for e in self.errors if not e.refit]


@dataclass(frozen=True, kw_only=True)
class EccentricityFindings:
    """What the report is made of.

    Attributes:
        scene: the study's.
        withdrawals: on exact contours, by (z_F in mm, incidence in degrees).
        limits: where models reach the limits, among the withdrawals.
        rendered: errors in rendered frames.
        geometries: number of points in the space of geometries.
        spreads: of the errors over the space.
        sensitivities: of the errors over the space.
        within: part of the space in which each model is within the largest limit.
    """

    scene: Scene
    withdrawals: dict[tuple[float, float], Withdrawals]
    limits: list[Limit]
    rendered: RenderedErrors
    geometries: int
    spreads: list[BinSpread]
    sensitivities: list[Sensitivity]
    within: dict[str, float]

    @property
    def analytic(self) -> list[ModelError]:
        """Errors on exact contours of all withdrawals, with the true c."""
        return [e for w in self.withdrawals.values() for e in w.errors if not e.refit]

    @property
    def refits(self) -> list[Refit]:
        """Fits of c on exact contours."""
        return [refit for w in self.withdrawals.values() for refit in w.refits]

    @property
    def heights(self) -> tuple[float, float]:
        """z_F of the pinholes that the report compares, mm."""
        return pinhole_heights(self.scene)

    def limits_of(
        self, model: str, height: float, incidence: float, *, refit: bool = False
    ) -> tuple[float, ...]:
        """c at which a model reaches each of `LIMITS_MM`, mm; NaN where it does not."""
        key = (model, refit, height, incidence)
        return tuple(row.c_mm for row in self.limits if row[:4] == key)


def pinhole_heights(scene: Scene) -> tuple[float, float]:
    """z_F of the paper's geometry, on the sphere, and of a microscope, mm."""
    return scene.phantom.radius_mm, MICROSCOPE_MM
