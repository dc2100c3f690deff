"""The c at which a model's error reaches a limit, with the true c and with a fitted one."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import pandas as pd

import optics
from benchmarks.evaluation import (
    Geometry,
    degrees,
    largest,
    limit_eccentricity,
    model_errors,
    refitted_errors,
    semi_minor,
)
from benchmarks.reporting import grouped

LARGEST_C_MM = 8.0
"""End of the axis c of every part."""

SHOWN_C_MM = 4.0
"""Where the report splits the error."""

LIMITS_MM = (0.1, 0.5)
"""Errors whose crossing is reported; the paper calls 0.5 mm acceptable."""

DISTANCES_MM = tuple(0.5 * n for n in range(1, 13))
"""Of one withdrawal, 0.5 to 6 mm."""


class Withdrawals(NamedTuple):
    """Errors over a grid of c and d for one pinhole and incidence.

    Attributes:
        errors: of all models with the true c, then of small_plane with the fitted one.
        refits: a fit for each c, see `refitted`.
    """

    errors: pd.DataFrame
    refits: pd.DataFrame


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
    tables, refits = [errors], []
    for value in eccentricities.tolist():
        rows, refit = refitted(
            geometry,
            before=errors[errors.c_mm == value],
            source="analytic",
            medium=medium,
            c=value,
            d=d[c == value],
            semi_minor_px=seen[c == value],
        )
        tables.append(rows)
        refits.append(refit)
    return Withdrawals(pd.concat(tables, ignore_index=True), pd.DataFrame(refits))


def refitted(
    geometry: Geometry,
    *,
    before: pd.DataFrame,
    source: str,
    medium: str,
    c: float,
    d: np.ndarray,
    semi_minor_px: np.ndarray,
) -> tuple[pd.DataFrame, dict[str, Any]]:
    """Errors of one withdrawal with c fitted, and what that hides of those `before`.

    The second is a row of refit.csv: the fitted c, the largest error before and after, and the
    part of it that the fitted c takes away, `hidden_mm`.

    Args:
        before: its errors with the true c, of every model.
        source: "analytic" or "rendered".
        c: mm.
        d: mm.
        semi_minor_px: e1', px.
    """
    fit, rows = refitted_errors(
        geometry, source=source, medium=medium, c=c, d=d, semi_minor_px=semi_minor_px
    )
    before_mm = largest(before.error_mm[before.model == "small_plane"])
    after_mm = largest(rows.error_mm)
    return rows, {
        "source": source,
        "z_f_mm": geometry.pinhole_height,
        "incidence_deg": degrees(geometry.incidence),
        "c_mm": c,
        "fitted_c_mm": fit.c,
        "at_bound": fit.at_bound,
        "largest_error_mm": before_mm,
        "largest_residual_mm": after_mm,
        "hidden_mm": before_mm - after_mm,
    }


def limits(errors: pd.DataFrame) -> pd.DataFrame:
    """Content of limits.csv: the smallest c at which the largest error over all d reaches a limit.

    `c_mm` is empty if the limit is not reached up to the largest c; 0 if it is exceeded from the
    start.
    """
    keys = ["model", "refit", "z_f_mm", "incidence_deg"]
    rows = [
        (*key, limit, limit_eccentricity(group, limit))
        for key, group in grouped(errors, *keys)
        for limit in LIMITS_MM
    ]
    return pd.DataFrame(rows, columns=[*keys, "limit_mm", "c_mm"])
