"""The rows of the CSV files, from the findings."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable

import numpy as np

import optics
from benchmarks.evaluation import (
    ALL_PLANES,
    CHOSEN_DISTANCES_MM,
    TABLE_I,
    TABLE_II,
    ModelError,
    StaticTrial,
    Tracked,
)
from benchmarks.studies.validate.findings import (
    FrameRow,
    PlaneFitRow,
    SphereFitRow,
    SpotRow,
    ValidateFindings,
)
from calibration import PlaneFit
from estimator import Spot
from scenes import Scene


def plane_rows(findings: ValidateFindings) -> list[PlaneFitRow]:
    """Table I for every source and way with fits."""
    return [
        PlaneFitRow(
            *(source, way, trial),
            *(fit.delta_k, fit.delta_k_error, TABLE_I[trial].delta_k),
            *(fit.b, fit.b_error, TABLE_I[trial].b),
            *(fit.r_squared, TABLE_I[trial].r_squared, fit.rmse, TABLE_I[trial].rmse),
            contact_radius_px=-fit.b / fit.delta_k,
            spots=fit.spots,
            converged=fit.converged,
        )
        for (source, way), fits in findings.plane_fits.items()
        for trial, fit in fits.items()
    ]


def sphere_rows(findings: ValidateFindings) -> list[SphereFitRow]:
    """Table II for every source and way with fits."""
    scenes = {(t.source, t.group): t.scene for t in findings.trials}
    return [
        SphereFitRow(
            *(source, way, trial),
            c_true_mm=scenes[source, trial].spot.eccentricity_mm,
            c_fitted_mm=fit.c,
            c_error_mm=fit.c_error,
            c_expected_mm=_expected_eccentricity(scenes[source, trial]),
            standard_deviation_mm=fit.standard_deviation,
            paper_standard_deviation_mm=TABLE_II[trial].standard_deviation,
            mean_absolute_error_mm=fit.mean_absolute_error,
            paper_mean_absolute_error_mm=TABLE_II[trial].mean_absolute_error,
            max_error_mm=fit.max_error,
            paper_max_error_mm=TABLE_II[trial].max_error,
            spots=fit.spots,
            converged=fit.converged,
            at_bound=fit.at_bound,
        )
        for (source, way), fits in findings.sphere_fits.items()
        for trial, fit in fits.items()
    ]


def spot_rows(findings: ValidateFindings) -> list[SpotRow]:
    """Every frame in every way in which it was measured."""
    trials = {trial.name: trial for trial in findings.trials}
    return [
        row
        for (name, way), tracked in findings.tracked.items()
        for row in _spot_rows(trials[name], way, tracked, findings)
    ]


def frame_rows(findings: ValidateFindings) -> list[FrameRow]:
    """Outcomes of all frames, counted."""
    sources = {trial.name: trial.source for trial in findings.trials}
    return [
        FrameRow(name, sources[name], way, outcome, frames)
        for (name, way), tracked in findings.tracked.items()
        for outcome, frames in sorted(Counter(tracked.outcomes).items())
    ]


def square_rows(errors: Iterable[ModelError], *, c: float) -> list[ModelError]:
    """The errors of a beam square to the wall, at one eccentricity and the chosen distances."""
    return [
        e
        for e in errors
        if e.incidence_deg == 0
        and math.isclose(e.c_mm, c)
        and any(math.isclose(e.d_mm, d) for d in CHOSEN_DISTANCES_MM)
    ]


def _expected_eccentricity(scene: Scene) -> float:
    """c' with cos(phi') = the right first-order factor at c, or 0 if that is above 1, mm."""
    r = scene.phantom.radius_mm
    factor = optics.corrected_factor(
        eccentricity=scene.spot.eccentricity_mm,
        eye_radius=r,
        inverse_working_distance=1.0 / (scene.microscope.pinhole_height_mm + r),
    )
    return r * math.sqrt(max(0.0, 1.0 - float(factor) ** 2))


def _spot_rows(
    trial: StaticTrial, way: str, tracked: Tracked, findings: ValidateFindings
) -> list[SpotRow]:
    measured = np.array(
        [r.semi_minor_px if isinstance(r, Spot) else math.nan for r in tracked.results]
    )
    outcomes = tracked.outcomes
    travel = np.array([row.d_mm - tracked.labels[0].d_mm for row in tracked.labels])
    estimate = np.where(tracked.used, _estimate(trial, way, measured, findings), math.nan)
    return [
        SpotRow(
            trial=trial.name,
            source=trial.source,
            group=trial.group,
            way=way,
            frame=row.frame,
            file_name=row.file_name,
            c_mm=row.c_mm,
            d_mm=row.d_mm,
            d_r_mm=float(travel[i]),
            visible_fraction=row.visible_fraction,
            saturated_fraction=row.saturated_fraction,
            outcome=outcomes[i],
            measured_px=float(measured[i]),
            half_max_px=row.half_max_semi_minor_px,
            cone_px=row.cone_semi_minor_px,
            estimate_mm=float(estimate[i]),
            residual_mm=float(estimate[i] - travel[i]),
        )
        for i, row in enumerate(tracked.labels)
    ]


def _estimate(
    trial: StaticTrial, way: str, semi_minor_px: np.ndarray, findings: ValidateFindings
) -> np.ndarray:
    """Distance since contact by the fit that the trial entered, mm; NaN without a fit."""
    planes = findings.plane_fits.get((trial.source, way), {})
    if trial.kind == "plane" and trial.group in planes:
        fit = planes[trial.group]
        return fit.delta_k * semi_minor_px + fit.b
    sphere = findings.sphere_fits.get((trial.source, way), {}).get(trial.group)
    if sphere is None:
        return np.full(semi_minor_px.shape, math.nan)
    return small_plane_curve(
        semi_minor_px,
        plane=planes[ALL_PLANES],
        c=sphere.c,
        scale=trial.scene.microscope.scale_mm_px,
        eye_radius=trial.scene.phantom.radius_mm,
    )


def small_plane_curve(
    semi_minor_px: np.ndarray, *, plane: PlaneFit, c: float, scale: float, eye_radius: float
) -> np.ndarray:
    """Distance by the small-plane model with the plane's delta k and b, mm."""
    return np.asarray(
        optics.small_plane_distance(
            semi_minor_px=semi_minor_px,
            scale=scale,
            k=plane.delta_k / scale,
            b=plane.b,
            eccentricity=c,
            eye_radius=eye_radius,
        )
    )
