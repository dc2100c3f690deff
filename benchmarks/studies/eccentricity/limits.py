"""The c at which a model's error reaches a limit, with the true c and with a fitted one."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

import optics
from benchmarks.evaluation import (
    Geometry,
    ModelError,
    degrees,
    largest,
    limit_eccentricity,
    model_errors,
    refitted_errors,
    semi_minor,
)
from benchmarks.studies.eccentricity.findings import (
    DISTANCES_MM,
    LIMITS_MM,
    Limit,
    Refit,
    Withdrawals,
)


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
    refits = []
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
        errors += rows
        refits.append(refit)
    return Withdrawals(errors, refits)


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
    before_mm, after_mm = (largest(e.error_mm for e in found) for found in (true_c, rows))
    return rows, Refit(
        source=source,
        z_f_mm=geometry.pinhole_height,
        incidence_deg=degrees(geometry.incidence),
        c_mm=c,
        fitted_c_mm=fit.c,
        at_bound=fit.at_bound,
        largest_error_mm=before_mm,
        largest_residual_mm=after_mm,
        hidden_mm=before_mm - after_mm,
    )


def limits(errors: Sequence[ModelError]) -> list[Limit]:
    """Where each model reaches each limit, for every pinhole and incidence among the errors."""
    groups: dict[tuple[str, bool, float, float], list[ModelError]] = {}
    for e in errors:
        groups.setdefault((e.model, e.refit, e.z_f_mm, e.incidence_deg), []).append(e)
    return [
        Limit(*key, limit_mm=limit, c_mm=limit_eccentricity(group, limit))
        for key, group in groups.items()
        for limit in LIMITS_MM
    ]
