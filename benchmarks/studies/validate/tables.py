"""The rows behind the report: one class a CSV file, its fields the columns, with units."""

from __future__ import annotations

import csv
import math
from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import optics
from benchmarks.evaluation import TABLE_I, TABLE_II, ModelError, Tracked, Trial
from benchmarks.studies.validate.run import Findings
from calibration import PlaneFit
from estimator import Spot

ALL_PLANES = "all planes"
"""The fit of all plane trials together."""

CHOSEN_DISTANCES_MM = (0.5, 2.0, 4.0, 6.0)
"""Distances that tables and error curves show."""


class PlaneRow(NamedTuple):
    """Row of table_1.csv: a fit of delta k and b beside what the paper prints."""

    source: str
    way: str
    trial: str
    delta_k_mm_px: float
    delta_k_error_mm_px: float
    paper_delta_k_mm_px: float
    b_mm: float
    b_error_mm: float
    paper_b_mm: float
    r_squared: float
    paper_r_squared: float
    rmse_mm: float
    paper_rmse_mm: float
    contact_radius_px: float
    spots: int
    converged: bool


class SphereRow(NamedTuple):
    """Row of table_2.csv: a fit of c beside the truth and what the paper prints.

    `c_expected_mm` is where the paper's factor cos(phi) equals the right one of the true c.
    """

    source: str
    way: str
    trial: str
    c_true_mm: float
    c_fitted_mm: float
    c_error_mm: float
    c_expected_mm: float
    standard_deviation_mm: float
    paper_standard_deviation_mm: float
    mean_absolute_error_mm: float
    paper_mean_absolute_error_mm: float
    max_error_mm: float
    paper_max_error_mm: float
    spots: int
    converged: bool
    at_bound: bool


class SpotRow(NamedTuple):
    """Row of spots.csv: truth and measurement of one frame in one way.

    `estimate_mm` comes from the fit that the frame entered and counts from contact, as d_r does.
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
    """Row of frames.csv: how many frames of a trial had one outcome in one way."""

    trial: str
    source: str
    way: str
    outcome: str
    frames: int


class Accuracy(NamedTuple):
    """Row of rendered_accuracy.csv: a model's errors over all measured spots of the grid."""

    model: str
    z_f_mm: float
    spots: int
    mean_error_mm: float
    max_abs_error_mm: float


def plane_rows(findings: Findings) -> list[PlaneRow]:
    """Table I for every source and way that could be fitted."""
    return [
        PlaneRow(
            source=source,
            way=way,
            trial=trial,
            delta_k_mm_px=fit.delta_k,
            delta_k_error_mm_px=fit.delta_k_error,
            paper_delta_k_mm_px=TABLE_I[trial].delta_k,
            b_mm=fit.b,
            b_error_mm=fit.b_error,
            paper_b_mm=TABLE_I[trial].b,
            r_squared=fit.r_squared,
            paper_r_squared=TABLE_I[trial].r_squared,
            rmse_mm=fit.rmse,
            paper_rmse_mm=TABLE_I[trial].rmse,
            contact_radius_px=-fit.b / fit.delta_k,
            spots=fit.spots,
            converged=fit.converged,
        )
        for (source, way), fits in findings.plane_fits.items()
        for trial, fit in fits.items()
    ]


def sphere_rows(findings: Findings) -> list[SphereRow]:
    """Table II for every source and way that could be fitted."""
    scenes = {(t.source, t.group): t.scene for t in findings.trials}
    rows = []
    for (source, way), fits in findings.sphere_fits.items():
        for trial, fit in fits.items():
            scene = scenes[source, trial]
            rows.append(
                SphereRow(
                    source=source,
                    way=way,
                    trial=trial,
                    c_true_mm=scene.spot.eccentricity_mm,
                    c_fitted_mm=fit.c,
                    c_error_mm=fit.c_error,
                    c_expected_mm=_expected_eccentricity(
                        c=scene.spot.eccentricity_mm,
                        eye_radius=scene.phantom.radius_mm,
                        pinhole_height=scene.microscope.pinhole_height_mm,
                    ),
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
            )
    return rows


def spot_rows(findings: Findings) -> list[SpotRow]:
    """Every frame in every way that it was measured."""
    trials = {trial.name: trial for trial in findings.trials}
    return [
        row
        for (name, way), tracked in findings.tracked.items()
        for row in _spot_rows(trials[name], way, tracked, findings)
    ]


def frame_rows(findings: Findings) -> list[FrameRow]:
    """Outcomes of all frames, counted."""
    sources = {trial.name: trial.source for trial in findings.trials}
    return [
        FrameRow(name, sources[name], way, outcome, frames)
        for (name, way), tracked in findings.tracked.items()
        for outcome, frames in sorted(Counter(tracked.outcomes).items())
    ]


def rendered_accuracy(errors: Sequence[ModelError]) -> list[Accuracy]:
    """Each model's errors on measured spots, by pinhole height."""
    groups = dict.fromkeys((e.z_f_mm, e.model) for e in errors)
    rows = []
    for height, model in groups:
        values = np.array([e.error_mm for e in errors if (e.z_f_mm, e.model) == (height, model)])
        rows.append(
            Accuracy(
                model=model,
                z_f_mm=height,
                spots=values.size,
                mean_error_mm=float(np.mean(values)),
                max_abs_error_mm=float(np.max(np.abs(values))),
            )
        )
    return rows


def square_rows(errors: Iterable[ModelError], *, c: float) -> list[ModelError]:
    """Those of a beam square to the wall, at one eccentricity and the chosen distances."""
    return [
        e
        for e in errors
        if e.incidence_deg == 0
        and math.isclose(e.c_mm, c)
        and any(math.isclose(e.d_mm, d) for d in CHOSEN_DISTANCES_MM)
    ]


def write_csv(path: Path, row_type: type[Any], rows: Iterable[Any]) -> None:
    """Write named tuples with a header line; NaN is an empty cell."""
    with path.open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(row_type._fields)
        writer.writerows([_cell(value) for value in row] for row in rows)


def _cell(value: object) -> object:
    return "" if isinstance(value, float) and math.isnan(value) else value


def _expected_eccentricity(*, c: float, eye_radius: float, pinhole_height: float) -> float:
    """c' with cos(phi') = the right first-order factor at c, or 0 where that is above 1, mm."""
    factor = float(
        optics.corrected_factor(
            eccentricity=c,
            eye_radius=eye_radius,
            inverse_working_distance=1.0 / (pinhole_height + eye_radius),
        )
    )
    return eye_radius * math.sqrt(max(0.0, 1.0 - factor**2))


def _spot_rows(trial: Trial, way: str, tracked: Tracked, findings: Findings) -> list[SpotRow]:
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


def _estimate(trial: Trial, way: str, semi_minor_px: np.ndarray, findings: Findings) -> np.ndarray:
    """Distance since contact by the fit that the trial entered, mm; NaN where there is none."""
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
