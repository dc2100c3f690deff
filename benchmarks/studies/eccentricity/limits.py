"""At which c a model leaves a limit, with the true c and with c fitted as the paper does."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

import optics
from benchmarks.evaluation import (
    Geometry,
    ModelError,
    degrees,
    model_errors,
    refitted_errors,
    semi_minor,
)
from benchmarks.studies.validate import limit_eccentricity

LIMITS_MM = (0.1, 0.5)
"""Errors whose crossing is told; 0.5 mm is what the paper calls acceptable."""

DISTANCES_MM = tuple(0.5 * n for n in range(1, 13))
"""Of one withdrawal, 0.5 to 6 mm."""


class Limit(NamedTuple):
    """Row of limits.csv: the smallest c at which the largest error over all d reaches the limit.

    `c_mm` is empty where that does not happen up to the largest c; 0 where it is so from the start.
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
    z_f_mm: float
    incidence_deg: float
    c_mm: float
    fitted_c_mm: float
    at_bound: bool
    largest_error_mm: float
    largest_residual_mm: float
    hidden_mm: float


class Withdrawals(NamedTuple):
    """Errors over a grid of c and d for one pinhole and incidence.

    Attributes:
        errors: of all models with the true c, then of small_plane with the fitted one.
        refits: a fit for each c.
    """

    errors: list[ModelError]
    refits: list[Refit]


def withdrawals(geometry: Geometry, *, eccentricities: np.ndarray, medium: str) -> Withdrawals:
    """Errors on exact contours at each c (mm) and all `DISTANCES_MM`."""
    c, d = (a.ravel() for a in np.meshgrid(eccentricities, DISTANCES_MM, indexing="ij"))
    seen = semi_minor(geometry, c=c, d=d)
    errors = model_errors(
        geometry,
        source="analytic",
        medium=medium,
        c=c,
        d=d,
        semi_minor_px=seen,
        models=optics.MODELS,
    )
    found = Withdrawals(list(errors), [])
    for value in eccentricities.tolist():
        rows, refit = refitted(
            geometry,
            before=[e for e in errors if e.c_mm == value],
            source="analytic",
            medium=medium,
            c=value,
            d=d[c == value],
            semi_minor_px=seen[c == value],
        )
        found.errors.extend(rows)
        found.refits.append(refit)
    return found


def refitted(
    geometry: Geometry,
    *,
    before: Sequence[ModelError],
    source: str,
    medium: str,
    c: float,
    d: np.ndarray,
    semi_minor_px: np.ndarray,
) -> tuple[list[ModelError], Refit]:
    """Errors of one withdrawal with c fitted, and what that hides of those `before`.

    Args:
        geometry: of the withdrawal.
        before: its errors with the true c, of every model.
        source: "analytic" or "rendered".
        medium: by name.
        c: mm.
        d: mm.
        semi_minor_px: e1', px.
    """
    fit, rows = refitted_errors(
        geometry, source=source, medium=medium, c=c, d=d, semi_minor_px=semi_minor_px
    )
    true_c = [e for e in before if e.model == "small_plane"]
    largest, residual = (max(abs(e.error_mm) for e in found) for found in (true_c, rows))
    return rows, Refit(
        source=source,
        z_f_mm=geometry.pinhole_height,
        incidence_deg=degrees(geometry.incidence),
        c_mm=c,
        fitted_c_mm=fit.c,
        at_bound=fit.at_bound,
        largest_error_mm=largest,
        largest_residual_mm=residual,
        hidden_mm=largest - residual,
    )


def limits(errors: Sequence[ModelError]) -> list[Limit]:
    """Where each model leaves each limit, for every pinhole and incidence among the errors."""
    groups: dict[tuple[str, bool, float, float], list[ModelError]] = {}
    for e in errors:
        groups.setdefault((e.model, e.refit, e.z_f_mm, e.incidence_deg), []).append(e)
    rows = []
    for key, group in groups.items():
        for limit in LIMITS_MM:
            c = limit_eccentricity(group, limit)
            rows.append(Limit(*key, limit_mm=limit, c_mm=math.nan if c is None else c))
    return rows
