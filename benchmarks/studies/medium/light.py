"""What a medium makes of a lens's half-maximum radius, in closed form from the lens's light."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

import optics
from scenes.world import Cone, lens_light

AIR, VITREOUS = "air", "vitreous"
NEAREST_MM, FARTHEST_MM = 0.5, 6.0
"""Distances of the paper's trials: calibrated and asked for."""

AIR_CONE, LENS_CONE, LENS = "cone of air", "cone of the lens model", "lens model"
"""How a radius becomes a distance: by the cone calibrated in air; by the cone that the same lens
makes in the medium, computed; by the lens's own curve in the medium."""

CONE = "cone"
"""The light that is no lens: the control."""

_LOOKED_UP_MM = np.linspace(0.05, 8.0, 1600)  # distances whose radii are compared with a given one


class MediumError(NamedTuple):
    """Row of medium_error.csv; error = estimate - truth.

    `light`: a lens by name, or "cone"; where the answer is `ambiguous` the analytic estimate is
    the solution farthest from the truth, the rendered one the likeliest. An empty `estimate_mm`:
    the method has none.
    """

    source: str
    light: str
    medium: str
    method: str
    d_mm: float
    radius_mm: float
    estimate_mm: float
    error_mm: float
    ambiguous: bool


class Regression(NamedTuple):
    """Row of medium_cones.csv: the cone d = kR + b that a lens makes in a medium."""

    light: str
    medium: str
    k: float
    b_mm: float
    r_squared: float
    ambiguous_from_mm: float
    ambiguous_to_mm: float


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
        """All distances at which the light has this radius, mm; from none to several."""
        over = self.radius - radius
        before, after = over[:-1], over[1:]
        step = np.flatnonzero((before < 0) != (after < 0))
        share = before[step] / (before[step] - after[step])
        return self.distance[step] + share * np.diff(self.distance)[step]


def lens_curve(lens: str, medium: str) -> Curve:
    """Of a glue lens; its light is computed once for half a minute and then kept.

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
    return Curve(lens, medium, _LOOKED_UP_MM, radius, regression)


def cone_curve(cone: Cone, medium: str) -> Curve:
    """Of the ideal cone, which is the same in every medium: the control."""
    k = 1.0 / np.tan(cone.half_angle)
    radius = (_LOOKED_UP_MM - cone.apex_offset) / k
    regression = Regression(CONE, medium, float(k), cone.apex_offset, 1.0, np.nan, np.nan)
    return Curve(CONE, medium, _LOOKED_UP_MM, radius, regression)


def analytic_errors(air: Curve, medium: Curve, *, distances: np.ndarray) -> list[MediumError]:
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
        for method, estimate in (
            (AIR_CONE, by_cone(air.regression, radius)),
            (LENS_CONE, by_cone(medium.regression, radius)),
            (LENS, float(farthest)),
        ):
            rows.append(
                MediumError(
                    source="analytic",
                    light=medium.light,
                    medium=medium.medium,
                    method=method,
                    d_mm=d,
                    radius_mm=radius,
                    estimate_mm=estimate,
                    error_mm=estimate - d,
                    ambiguous=method == LENS and solutions.size > 1,
                )
            )
    return rows


def by_cone(regression: Regression, radius: float) -> float:
    """d = kR + b, mm (Zhou et al. 2020, eq. 1)."""
    return regression.k * radius + regression.b_mm
