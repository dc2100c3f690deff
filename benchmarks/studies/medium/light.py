"""Half-maximum radius of a light in a medium against distance, in closed form."""

from __future__ import annotations

from enum import StrEnum
from typing import NamedTuple

import numpy as np
import pandas as pd

import optics
from scenes.world import Cone, lens_light

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


class Regression(NamedTuple):
    """Row of medium_cones.csv: the cone d = kR + b that a lens makes in a medium.

    Between the two ambiguous distances one radius has more than one solution.
    """

    light: str
    medium: str
    k: float
    b_mm: float
    r_squared: float
    ambiguous_from_mm: float
    ambiguous_to_mm: float

    def distance(self, radius: float) -> float:
        """d = kR + b, mm (Zhou et al. 2020, eq. 1)."""
        return self.k * radius + self.b_mm


class Curve(NamedTuple):
    """Half-maximum radius (mm) of a light in a medium against distance (mm), and its cone."""

    distance: np.ndarray
    radius: np.ndarray
    cone: Regression

    def distances_of(self, radius: float) -> np.ndarray:
        """All distances at which the light has this radius, mm; there may be none or several."""
        over = self.radius - radius
        before, after = over[:-1], over[1:]
        step = np.flatnonzero((before < 0) != (after < 0))
        share = before[step] / (before[step] - after[step])
        return self.distance[step] + share * np.diff(self.distance)[step]


_LOOKED_UP_MM = np.linspace(0.05, 8.0, 1600)  # distances whose radii are compared with a given one


def lens_curve(lens: str, medium: str) -> Curve:
    """The curve of a glue lens; its light takes half a minute the first time and is then kept.

    Args:
        lens: preset name or path of a lens file.
        medium: of `optics.MEDIA`.
    """
    table = lens_light(lens, optics.MEDIA[medium]).table
    cone = optics.effective_cone(table, from_distance=NEAREST_MM, to_distance=FARTHEST_MM)
    unclear = optics.ambiguous_distances(table, from_distance=NEAREST_MM, to_distance=FARTHEST_MM)
    first, last = (unclear[0][0], unclear[-1][1]) if unclear else (np.nan, np.nan)
    radius = np.asarray(optics.half_maximum_radius(table, distance=_LOOKED_UP_MM))
    k, b, r_squared = float(cone.k), float(cone.b), float(cone.r_squared)
    regression = Regression(lens, medium, k, b, r_squared, first, last)
    return Curve(_LOOKED_UP_MM, radius, regression)


def cone_curve(cone: Cone, medium: str) -> Curve:
    """The curve of the ideal cone, which is the same in every medium."""
    k = 1.0 / np.tan(cone.half_angle)
    radius = (_LOOKED_UP_MM - cone.apex_offset) / k
    regression = Regression(CONE, medium, float(k), cone.apex_offset, 1.0, np.nan, np.nan)
    return Curve(_LOOKED_UP_MM, radius, regression)


COLUMNS = "source light medium method d_mm radius_mm estimate_mm error_mm ambiguous".split()
"""Of medium_error.csv; error = estimate - truth.

If the result is ambiguous, the analytic estimate is the solution farthest from the truth and the
rendered one is the most likely solution; without a result the estimate is empty.
"""


def analytic_errors(air: Curve, medium: Curve, *, distances: np.ndarray) -> pd.DataFrame:
    """Errors of the three methods on the square wall's half-maximum radii in a medium.

    Args:
        air: the light in air, where it was calibrated.
        medium: the same light where it is used; may be air.
        distances: mm.
    """
    rows = []
    for d in distances.tolist():
        radius = float(np.interp(d, medium.distance, medium.radius))
        solutions = medium.distances_of(radius)
        solutions = solutions[(solutions >= NEAREST_MM) & (solutions <= FARTHEST_MM)]
        farthest = solutions[np.argmax(np.abs(solutions - d))] if solutions.size else d
        for method, estimate, ambiguous in (
            (Method.AIR_CONE, air.cone.distance(radius), False),
            (Method.LENS_CONE, medium.cone.distance(radius), False),
            (Method.LENS, float(farthest), solutions.size > 1),
        ):
            light = ("analytic", medium.cone.light, medium.cone.medium, method)
            rows.append((*light, d, radius, estimate, estimate - d, ambiguous))
    return pd.DataFrame(rows, columns=COLUMNS)
