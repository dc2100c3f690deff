"""The results as data: curves of light sources, errors of distances."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Annotated, NamedTuple

import numpy as np

from benchmarks.reporting import Column
from calibration import PlaneFit
from scenes import Scene

AIR, VITREOUS = "air", "vitreous"
NEAREST_MM, FARTHEST_MM = 0.5, 6.0
"""Range of distances of calibration and measurement, as in the paper's trials."""

CONE = "cone"
"""The light without a lens: the control."""


class Method(StrEnum):
    """Methods to compute a distance from a radius."""

    AIR_CONE = "cone of air"
    """The cone calibrated in air."""

    LENS_CONE = "cone of the lens model"
    """The cone that the same lens makes in the medium, computed."""

    LENS = "lens model"
    """The lens's own curve in the medium."""


class MediumError(NamedTuple):
    """Row of medium_error.csv; error = estimate - truth.

    `light`: a lens by name, or "cone". If the result is `ambiguous`, the analytic estimate is the
    solution farthest from the truth and the rendered one is the most likely solution. `estimate_mm`
    is empty if the method has no result.
    """

    source: str
    light: str
    medium: str
    method: Method
    d_mm: float
    radius_mm: float
    estimate_mm: float
    error_mm: float
    ambiguous: bool


class Regression(NamedTuple):
    """Row of medium_cones.csv: the cone d = kR + b that a lens makes in a medium."""

    light: Annotated[str, Column("light")]
    medium: Annotated[str, Column("medium")]
    k: Annotated[float, Column("k")]
    b_mm: Annotated[float, Column("b, mm")]
    r_squared: Annotated[float, Column("R²")]
    ambiguous_from_mm: Annotated[float, Column("ambiguous from d, mm", 2)]
    ambiguous_to_mm: Annotated[float, Column("to d, mm", 2)]


class Curve(NamedTuple):
    """Half-maximum radius of a light in a medium against distance.

    Attributes:
        light: lens by name, or "cone".
        medium: by name.
        distance: mm.
        radius: mm.
        regression: its cone, and the first and last distance with more than one solution.
    """

    light: str
    medium: str
    distance: np.ndarray
    radius: np.ndarray
    regression: Regression

    def distances_of(self, radius: float) -> np.ndarray:
        """All distances at which the light has this radius, mm; there may be none or several."""
        over = self.radius - radius
        before, after = over[:-1], over[1:]
        step = np.flatnonzero((before < 0) != (after < 0))
        share = before[step] / (before[step] - after[step])
        return self.distance[step] + share * np.diff(self.distance)[step]


@dataclass(frozen=True, kw_only=True)
class MediumFindings:
    """All results of a run.

    Attributes:
        scene: the study's.
        curves: half-maximum radius against distance, by light and medium.
        fits: in air, on rendered planes, by light.
        rows: errors, analytic and rendered.
    """

    scene: Scene
    curves: dict[tuple[str, str], Curve]
    fits: dict[str, PlaneFit]
    rows: list[MediumError]

    @property
    def lights(self) -> list[str]:
        """The lenses and the cone, in order."""
        return list(dict.fromkeys(light for light, _ in self.curves))

    @property
    def regressions(self) -> list[Regression]:
        """The cones of all lights in all media."""
        return [curve.regression for curve in self.curves.values()]

    def some(self, source: str, light: str, medium: str, method: Method) -> list[MediumError]:
        """The rows of one source ("analytic" or "rendered"), light, medium and method."""
        return [row for row in self.rows if row[:4] == (source, light, medium, method)]

    def errors(self, source: str, light: str, medium: str, method: Method) -> list[float]:
        """Their errors, mm; NaN without an answer."""
        return [row.error_mm for row in self.some(source, light, medium, method)]
