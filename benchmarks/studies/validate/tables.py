"""The fits of Tables I and II, the model errors, and the tables of the CSV files."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd

import optics
from benchmarks.evaluation import (
    ALL_PLANES,
    CHOSEN_DISTANCES_MM,
    PINHOLE_HEIGHTS_MM,
    SUBPIXEL,
    TABLE_I,
    TABLE_II,
    TILT_AZIMUTHS_DEG,
    WAYS,
    Criterion,
    PlaneRow,
    StaticTrial,
    Tracked,
    Way,
    geometry_of,
    grid_trials,
    measured_errors,
    model_error,
    reproduction,
)
from benchmarks.reporting import Claim
from calibration import PlaneFit, SphereFit, fit_eccentricity, fit_lines, fit_plane
from estimator import Spot
from scenes import Scene

CHOSEN_ECCENTRICITIES_MM = (3.0, 5.0)
"""Eccentricities at which the report gives the model errors."""
_ANALYTIC_HEIGHTS_MM = (*PINHOLE_HEIGHTS_MM, 100.0)
_FEWEST_SPOTS = 6  # fewer do not determine a line and its scatter
_STEP_MM = 0.5
_SHORTEST_MM = 2.0


@dataclass(frozen=True, kw_only=True)
class ValidateFindings:
    """All results of a run.

    Attributes:
        stacks: folder of the rendered stacks.
        tracked: by (trial name, way of measuring).
        plane_fits: by (source, way), then by "plane 1" … and "all planes".
        sphere_fits: by (source, way), then by "sphere 1" …
        analytic: model errors on exact contours.
        rendered: model errors on measured spots of the ideal cone.
    """

    stacks: Path
    trials: list[StaticTrial]
    tracked: dict[tuple[str, str], Tracked]
    plane_fits: dict[tuple[str, str], dict[str, PlaneFit]]
    sphere_fits: dict[tuple[str, str], dict[str, SphereFit]]
    analytic: pd.DataFrame
    rendered: pd.DataFrame

    def planes(self, source: str) -> list[StaticTrial]:
        """The trials of a source on the plane."""
        return [t for t in self.trials if (t.source, t.kind) == (source, "plane")]

    @property
    def sources(self) -> list[str]:
        """The sources of the paper's trials."""
        return list(dict.fromkeys(t.source for t in self.trials if t.kind != "grid"))


# Fits and model errors.

Fits = tuple[
    dict[tuple[str, str], dict[str, PlaneFit]], dict[tuple[str, str], dict[str, SphereFit]]
]
"""Fits on planes and in spheres, by (source, way), then by trial."""


def fit_tables(trials: Sequence[StaticTrial], tracked: Mapping[tuple[str, str], Tracked]) -> Fits:
    """Tables I and II for every source and way of measuring with enough spots."""
    plane_fits, sphere_fits = {}, {}
    for source in ("lens", "cone"):
        for way in WAYS:
            enough = {
                (t.kind, t.group): tracked[t.name, way.name]
                for t in trials
                if t.source == source
                and t.kind != "grid"
                and np.sum(tracked[t.name, way.name].used) >= _FEWEST_SPOTS
            }
            planes = {group: t for (kind, group), t in enough.items() if kind == "plane"}
            spheres = {group: t for (kind, group), t in enough.items() if kind == "sphere"}
            if not planes:
                continue
            pooled = fit_plane(
                semi_minor_px=np.concatenate([t.semi_minor_px for t in planes.values()]),
                distance=np.concatenate([t.travel_mm for t in planes.values()]),
            )
            plane_fits[source, way.name] = {
                group: fit_plane(semi_minor_px=t.semi_minor_px, distance=t.travel_mm)
                for group, t in planes.items()
            } | {ALL_PLANES: pooled}
            scene = trials[0].scene
            sphere_fits[source, way.name] = {
                group: fit_eccentricity(
                    semi_minor_px=t.semi_minor_px,
                    distance=t.travel_mm,
                    delta_k=pooled.delta_k,
                    b=pooled.b,
                    scale=scene.microscope.scale_mm_px,
                    eye_radius=scene.phantom.radius_mm,
                )
                for group, t in spheres.items()
            }
    return plane_fits, sphere_fits


def analytic_errors(*, quick: bool) -> pd.DataFrame:
    """Errors on exact contours: square to the wall, and at the trials' incidence and azimuths."""
    geometry = geometry_of(grid_trials(quick=quick, seed=0)[0].scene)
    tilts = [(0.0, 0.0), *((geometry.incidence, azimuth) for azimuth in TILT_AZIMUTHS_DEG)]
    tables = [
        model_error.analytic_errors(
            geometry._replace(
                pinhole_height=height,
                incidence=incidence,
                incidence_azimuth=math.radians(azimuth_deg),
            ),
            eccentricities=np.linspace(0.0, 7.0, 8 if quick else 29),
            distances=np.arange(0.5, 6.01, 0.5),
        )
        for height in _ANALYTIC_HEIGHTS_MM
        for incidence, azimuth_deg in tilts
    ]
    return pd.concat(tables, ignore_index=True)


def rendered_errors(
    trials: Sequence[StaticTrial], tracked: Mapping[tuple[str, str], Tracked]
) -> pd.DataFrame:
    """Errors on measured spots of the grid, each pinhole height and azimuth in one batch."""
    tables = []
    grid = [t for t in trials if t.kind == "grid"]
    geometries = [geometry_of(t.scene) for t in grid]
    for geometry in dict.fromkeys(geometries):
        own = [t for t, its in zip(grid, geometries, strict=True) if its == geometry]
        seen = [tracked[t.name, SUBPIXEL.name] for t in own]
        tables.append(
            measured_errors(
                geometry,
                labels=[row for t in seen for row in t.used_labels],
                semi_minor_px=np.concatenate([t.semi_minor_px for t in seen]),
            )
        )
    return pd.concat(tables, ignore_index=True)


class PartialFit(NamedTuple):
    """The criteria of Table I on the spots of a part of the range, low <= d_r <= high (mm)."""

    low: float
    high: float
    criteria: dict[Criterion, Claim]

    @property
    def met(self) -> int:
        """Number of criteria that are met."""
        return sum(bool(claim.holds) for claim in self.criteria.values())


def nearest_reproduction(findings: ValidateFindings, *, source: str, way: Way) -> PartialFit | None:
    """The widest of those parts of the range that meet most criteria of Table I.

    The paper does not state the distances of its fits. This tries all parts of 2 mm or more that
    begin and end at multiples of 0.5 mm. None if no part has three spots of each trial.
    """
    tracked = {t.group: findings.tracked[t.name, way.name] for t in findings.planes(source)}
    farthest = max(t.travel_mm.max(initial=0.0) for t in tracked.values())
    ends = np.arange(0.0, farthest + 1e-6, _STEP_MM)
    parts = []
    for low in ends:
        for high in ends[ends >= low + _SHORTEST_MM]:
            spots = {}
            for group, t in tracked.items():
                inside = (t.travel_mm > low - 1e-6) & (t.travel_mm < high + 1e-6)
                spots[group] = t.semi_minor_px[inside], t.travel_mm[inside]
            if all(e.size >= 3 for e, _ in spots.values()):
                axes, travels = zip(*spots.values(), strict=True)
                spots[ALL_PLANES] = np.concatenate(axes), np.concatenate(travels)
                fits = {
                    group: PlaneRow(*(float(value) for value in fit_lines(e, d)))
                    for group, (e, d) in spots.items()
                }
                parts.append(PartialFit(float(low), float(high), reproduction(fits)))
    return max(parts, key=lambda part: (part.met, part.high - part.low), default=None)


def half_maximum_curve(findings: ValidateFindings) -> tuple[np.ndarray, np.ndarray] | None:
    """Distance and half-maximum radius (mm) of the lens on the first plane; None without a lens."""
    if not findings.planes("lens"):
        return None
    trial = findings.planes("lens")[0]
    labels = findings.tracked[trial.name, SUBPIXEL.name].labels
    radius_px = np.array([row.half_max_semi_minor_px for row in labels])
    d = np.array([row.d_mm for row in labels])
    return d, radius_px * trial.scene.microscope.scale_mm_px


def ambiguous_range(distance: np.ndarray, radius: np.ndarray) -> tuple[float, float] | None:
    """First and last distance that share their radius with another distance, or None."""
    largest_before = np.maximum.accumulate(np.concatenate([[-math.inf], radius[:-1]]))
    least_after = np.minimum.accumulate(np.concatenate([radius[1:], [math.inf]])[::-1])[::-1]
    shared = (radius <= largest_before) | (radius >= least_after)
    if not shared.any():
        return None
    return float(distance[shared].min()), float(distance[shared].max())


# Tables of the CSV files.


def plane_table(findings: ValidateFindings) -> pd.DataFrame:
    """Table I for every source and way with fits, and the paper's values."""
    return pd.DataFrame(
        {
            "source": source,
            "way": way,
            "trial": trial,
            "delta_k_mm_px": fit.delta_k,
            "delta_k_error_mm_px": fit.delta_k_error,
            "paper_delta_k_mm_px": TABLE_I[trial].delta_k,
            "b_mm": fit.b,
            "b_error_mm": fit.b_error,
            "paper_b_mm": TABLE_I[trial].b,
            "r_squared": fit.r_squared,
            "paper_r_squared": TABLE_I[trial].r_squared,
            "rmse_mm": fit.rmse,
            "paper_rmse_mm": TABLE_I[trial].rmse,
            "contact_radius_px": -fit.b / fit.delta_k,
            "spots": fit.spots,
            "converged": fit.converged,
        }
        for (source, way), fits in findings.plane_fits.items()
        for trial, fit in fits.items()
    )


def sphere_table(findings: ValidateFindings) -> pd.DataFrame:
    """Table II for every source and way with fits, the true c and the paper's values.

    `c_expected_mm` is the c whose factor cos(phi) equals the correct factor of the true c.
    """
    scenes = {(t.source, t.group): t.scene for t in findings.trials}
    return pd.DataFrame(
        {
            "source": source,
            "way": way,
            "trial": trial,
            "c_true_mm": scenes[source, trial].spot.eccentricity_mm,
            "c_fitted_mm": fit.c,
            "c_error_mm": fit.c_error,
            "c_expected_mm": _expected_eccentricity(scenes[source, trial]),
            "standard_deviation_mm": fit.standard_deviation,
            "paper_standard_deviation_mm": TABLE_II[trial].standard_deviation,
            "mean_absolute_error_mm": fit.mean_absolute_error,
            "paper_mean_absolute_error_mm": TABLE_II[trial].mean_absolute_error,
            "max_error_mm": fit.max_error,
            "paper_max_error_mm": TABLE_II[trial].max_error,
            "spots": fit.spots,
            "converged": fit.converged,
            "at_bound": fit.at_bound,
        }
        for (source, way), fits in findings.sphere_fits.items()
        for trial, fit in fits.items()
    )


def spot_table(findings: ValidateFindings) -> pd.DataFrame:
    """Truth and measurement of every frame in every way in which it was measured.

    `estimate_mm` comes from the fit that used the frame. It is zero at contact, like d_r.
    """
    trials = {trial.name: trial for trial in findings.trials}
    tables = []
    for (name, way), tracked in findings.tracked.items():
        trial, labels = trials[name], pd.DataFrame([vars(row) for row in tracked.labels])
        measured = np.array(
            [r.semi_minor_px if isinstance(r, Spot) else math.nan for r in tracked.results]
        )
        estimate = np.where(tracked.used, _estimate(trial, way, measured, findings), math.nan)
        travel = labels.d_mm - labels.d_mm[0]
        about = {"trial": name, "source": trial.source, "group": trial.group, "way": way}
        truth = ["frame", "file_name", "c_mm", "d_mm"]
        seen = {
            "d_r_mm": travel,
            "visible_fraction": labels.visible_fraction,
            "saturated_fraction": labels.saturated_fraction,
            "outcome": tracked.outcomes,
            "measured_px": measured,
            "half_max_px": labels.half_max_semi_minor_px,
            "cone_px": labels.cone_semi_minor_px,
            "estimate_mm": estimate,
            "residual_mm": estimate - travel,
        }
        tables.append(pd.DataFrame(about | {key: labels[key] for key in truth} | seen))
    return pd.concat(tables, ignore_index=True)


def frame_table(findings: ValidateFindings) -> pd.DataFrame:
    """Number of each trial's frames with one outcome in one way."""
    sources = {trial.name: trial.source for trial in findings.trials}
    rows = [
        (name, sources[name], way, outcome, frames)
        for (name, way), tracked in findings.tracked.items()
        for outcome, frames in sorted(Counter(tracked.outcomes).items())
    ]
    return pd.DataFrame(rows, columns=["trial", "source", "way", "outcome", "frames"])


def square_errors(errors: pd.DataFrame, *, c: float) -> pd.DataFrame:
    """The errors of a beam square to the wall, at one eccentricity and the chosen distances."""
    chosen = np.isclose(errors.d_mm.to_numpy()[:, None], CHOSEN_DISTANCES_MM).any(axis=1)
    return errors[(errors.incidence_deg == 0) & np.isclose(errors.c_mm, c) & chosen]


def _expected_eccentricity(scene: Scene) -> float:
    """c' with cos(phi') = the right first-order factor at c, or 0 if that is above 1, mm."""
    r = scene.phantom.radius_mm
    factor = optics.corrected_factor(
        eccentricity=scene.spot.eccentricity_mm,
        eye_radius=r,
        inverse_working_distance=1.0 / (scene.microscope.pinhole_height_mm + r),
    )
    return r * math.sqrt(max(0.0, 1.0 - float(factor) ** 2))


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
