"""The fits of Tables I and II, and the model errors, from the tracked trials."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from benchmarks.evaluation import (
    ALL_PLANES,
    PINHOLE_HEIGHTS_MM,
    SUBPIXEL,
    TILT_AZIMUTHS_DEG,
    WAYS,
    ModelError,
    StaticTrial,
    Tracked,
    geometry_of,
    grid_trials,
    measured_errors,
    model_error,
)
from calibration import PlaneFit, SphereFit, fit_eccentricity, fit_plane

_ANALYTIC_HEIGHTS_MM = (*PINHOLE_HEIGHTS_MM, 100.0)
_FEWEST_SPOTS = 6  # fewer do not determine a line and its scatter

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


def analytic_errors(*, quick: bool) -> list[ModelError]:
    """Errors on exact contours: square to the wall, and at the trials' incidence and azimuths."""
    geometry = geometry_of(grid_trials(quick=quick, seed=0)[0].scene)
    return [
        error
        for height in _ANALYTIC_HEIGHTS_MM
        for incidence, azimuth_deg in (
            (0.0, 0.0),
            *((geometry.incidence, azimuth) for azimuth in TILT_AZIMUTHS_DEG),
        )
        for error in model_error.analytic_errors(
            geometry._replace(
                pinhole_height=height,
                incidence=incidence,
                incidence_azimuth=math.radians(azimuth_deg),
            ),
            eccentricities=np.linspace(0.0, 7.0, 8 if quick else 29),
            distances=np.arange(0.5, 6.01, 0.5),
        )
    ]


def rendered_errors(
    trials: Sequence[StaticTrial], tracked: Mapping[tuple[str, str], Tracked]
) -> list[ModelError]:
    """Errors on measured spots of the grid, each pinhole height and azimuth in one batch."""
    errors: list[ModelError] = []
    grid = [t for t in trials if t.kind == "grid"]
    geometries = [geometry_of(t.scene) for t in grid]
    for geometry in dict.fromkeys(geometries):
        own = [t for t, its in zip(grid, geometries, strict=True) if its == geometry]
        seen = [tracked[t.name, SUBPIXEL.name] for t in own]
        errors += measured_errors(
            geometry,
            labels=[row for t in seen for row in t.used_labels],
            semi_minor_px=np.concatenate([t.semi_minor_px for t in seen]),
        )
    return errors
