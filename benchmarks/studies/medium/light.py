"""What a medium makes of a lens's half-maximum radius, in closed form from the lens's light."""

from __future__ import annotations

import numpy as np

import optics
from benchmarks.studies.medium.findings import (
    CONE,
    FARTHEST_MM,
    NEAREST_MM,
    Curve,
    MediumError,
    Method,
    Regression,
)
from scenes.world import Cone, lens_light

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
    return Curve(lens, medium, _LOOKED_UP_MM, radius, regression)


def cone_curve(cone: Cone, medium: str) -> Curve:
    """The curve of the ideal cone, which is the same in every medium."""
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
            (Method.AIR_CONE, by_cone(air.regression, radius)),
            (Method.LENS_CONE, by_cone(medium.regression, radius)),
            (Method.LENS, float(farthest)),
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
                    ambiguous=method == Method.LENS and solutions.size > 1,
                )
            )
    return rows


def by_cone(regression: Regression, radius: float) -> float:
    """d = kR + b, mm (Zhou et al. 2020, eq. 1)."""
    return regression.k * radius + regression.b_mm
