"""How far each model of the spot is from the truth, on exact contours and on measured spots."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from typing import Annotated, Any, NamedTuple

import jax
import numpy as np

import optics
from benchmarks.evaluation.summaries import largest, mean
from benchmarks.reporting import Column
from calibration import SphereFit, fit_eccentricity
from estimator import FrameLabels
from scenes import Scene
from scenes.world import World

COMPARED = ("small_plane", "corrected", "stereographic", "exact")
"""The models of a spot in an eyeball; `planar` is one of a plane."""


class Geometry(NamedTuple):
    """Microscope, eye and cone that one table of errors shares; mm and rad."""

    scale: float
    pinhole_height: float
    eye_radius: float
    half_angle: float
    apex_offset: float
    incidence: float
    incidence_azimuth: float


class ModelError(NamedTuple):
    """Row of model_error.csv; error = estimate - truth.

    `azimuth_deg` is the incidence's, counted from the meridian of O; `refit`: c was fitted to the
    spots, as the paper does, and `c_mm` is the true one.
    """

    model: str
    source: str
    refit: bool
    medium: str
    c_mm: float
    d_mm: float
    r_mm: float
    z_f_mm: float
    incidence_deg: float
    azimuth_deg: float
    half_angle_deg: float
    apex_offset_mm: float
    estimate_mm: float
    error_mm: float


class Accuracy(NamedTuple):
    """Row of rendered_accuracy.csv: a model's errors over all measured spots of one geometry."""

    model: Annotated[str, Column("model")]
    z_f_mm: Annotated[float, Column("z_F, mm", 1)]
    azimuth_deg: Annotated[float, Column("azimuth, °", 0)]
    spots: Annotated[int, Column("spots")]
    mean_error_mm: Annotated[float, Column("mean error, mm", 4, sign=True)]
    max_abs_error_mm: Annotated[float, Column("largest |error|, mm", 4)]


def geometry_of(scene: Scene) -> Geometry:
    """The geometry that the models are given of a scene."""
    half_angle, b = World(scene).cone
    return Geometry(
        scale=scene.microscope.scale_mm_px,
        pinhole_height=scene.microscope.pinhole_height_mm,
        eye_radius=scene.phantom.radius_mm,
        half_angle=half_angle,
        apex_offset=b,
        incidence=math.radians(scene.spot.incidence_deg),
        incidence_azimuth=math.radians(scene.spot.incidence_azimuth_deg),
    )


def analytic_errors(
    geometry: Geometry, *, eccentricities: np.ndarray, distances: np.ndarray
) -> list[ModelError]:
    """Errors of the models on the exact contour, at each c and d (mm)."""
    c, d = (a.ravel() for a in np.meshgrid(eccentricities, distances, indexing="ij"))
    seen = semi_minor(geometry, c=c, d=d)
    return model_errors(geometry, source="analytic", medium="air", c=c, d=d, semi_minor_px=seen)


def measured_errors(
    geometry: Geometry,
    *,
    labels: Sequence[FrameLabels],
    semi_minor_px: np.ndarray,
    models: Sequence[str] = COMPARED,
) -> list[ModelError]:
    """Errors of the models on measured spots whose truth is known."""
    return model_errors(
        geometry,
        source="rendered",
        medium=labels[0].medium,
        c=np.array([row.c_mm for row in labels]),
        d=np.array([row.d_mm for row in labels]),
        semi_minor_px=semi_minor_px,
        models=models,
    )


def model_errors(
    geometry: Geometry,
    *,
    source: str,
    medium: str,
    c: np.ndarray,
    d: np.ndarray,
    semi_minor_px: np.ndarray,
    models: Sequence[str] = COMPARED,
) -> list[ModelError]:
    """Errors of the models on spots of known size, at c and d (mm), which they are given."""
    found = estimates(geometry, c=c, semi_minor_px=semi_minor_px)
    return _rows(geometry, source, medium, c=c, d=d, found={m: found[m] for m in models})


def refitted_errors(
    geometry: Geometry,
    *,
    source: str,
    medium: str,
    c: float,
    d: np.ndarray,
    semi_minor_px: np.ndarray,
) -> tuple[SphereFit, list[ModelError]]:
    """Errors of `small_plane` with c fitted to the spots themselves, as the paper's Table II does.

    Args:
        geometry: k, b and r are given to the fit, as they are.
        source: "analytic" or "rendered".
        medium: by name.
        c: the true eccentricity of all spots, mm.
        d: their distances, mm.
        semi_minor_px: e1', px.

    Returns:
        The fit, and a row a spot, whose `c_mm` is the true one.
    """
    k = 1.0 / math.tan(geometry.half_angle)
    fit = fit_eccentricity(
        semi_minor_px=semi_minor_px,
        distance=d,
        delta_k=geometry.scale * k,
        b=geometry.apex_offset,
        scale=geometry.scale,
        eye_radius=geometry.eye_radius,
    )
    estimate = optics.small_plane_distance(
        semi_minor_px=semi_minor_px,
        scale=geometry.scale,
        k=k,
        b=geometry.apex_offset,
        eccentricity=fit.c,
        eye_radius=geometry.eye_radius,
    )
    found = {"small_plane": np.asarray(estimate)}
    true_c = np.full(d.shape, c)
    return fit, _rows(geometry, source, medium, c=true_c, d=d, found=found, refit=True)


def semi_minor(geometry: Geometry, *, c: np.ndarray, d: np.ndarray) -> np.ndarray:
    """e1' of the exact contour at eccentricities and distances (mm), px."""
    return np.asarray(_semi_minor(geometry, c, d))


def estimates(
    geometry: Geometry, *, c: np.ndarray, semi_minor_px: np.ndarray
) -> dict[str, np.ndarray]:
    """Distance by every model, mm, from e1' (px) at known eccentricity (mm)."""
    values = _estimates(geometry, c, semi_minor_px)
    return {model: np.asarray(distance) for model, distance in values.items()}


def accuracy(errors: Sequence[ModelError]) -> list[Accuracy]:
    """Each model's errors by pinhole height and azimuth of the incidence."""
    by_geometry: dict[tuple[str, float, float], list[float]] = {}
    for e in errors:
        by_geometry.setdefault((e.model, e.z_f_mm, e.azimuth_deg), []).append(e.error_mm)
    return [
        Accuracy(*key, len(values), mean(values), largest(values))
        for key, values in by_geometry.items()
    ]


def largest_errors(errors: Iterable[ModelError]) -> tuple[list[float], list[float]]:
    """Eccentricities in order, and the largest absolute error over all distances at each; mm."""
    worst: dict[float, float] = {}
    for e in errors:
        c = round(e.c_mm, 6)
        worst[c] = max(worst.get(c, 0.0), abs(e.error_mm))
    return sorted(worst), [worst[c] for c in sorted(worst)]


def limit_eccentricity(errors: Iterable[ModelError], limit: float) -> float:
    """Smallest c at which the largest error over all distances reaches the limit, mm.

    Linear between the eccentricities computed; NaN if the limit is never reached.
    """
    before: tuple[float, float] | None = None
    for c, size in zip(*largest_errors(errors), strict=True):
        if size >= limit:
            if before is None:
                return c
            return before[0] + (c - before[0]) * (limit - before[1]) / (size - before[1])
        before = c, size
    return math.nan


def _rows(
    geometry: Geometry,
    source: str,
    medium: str,
    *,
    c: np.ndarray,
    d: np.ndarray,
    found: Mapping[str, np.ndarray],
    refit: bool = False,
) -> list[ModelError]:
    return [
        ModelError(
            model=model,
            source=source,
            refit=refit,
            medium=medium,
            **place(geometry, c=c[i], d=d[i]),
            estimate_mm=float(estimate),
            error_mm=float(estimate - d[i]),
        )
        for model, values in found.items()
        for i, estimate in enumerate(values)
    ]


def place(geometry: Geometry, *, c: float, d: float) -> dict[str, Any]:
    """The columns of a CSV file for the place of a spot and its geometry."""
    return {
        "c_mm": float(c),
        "d_mm": float(d),
        "r_mm": geometry.eye_radius,
        "z_f_mm": geometry.pinhole_height,
        "incidence_deg": degrees(geometry.incidence),
        "azimuth_deg": degrees(geometry.incidence_azimuth),
        "half_angle_deg": degrees(geometry.half_angle),
        "apex_offset_mm": geometry.apex_offset,
    }


def degrees(radians: float) -> float:
    """An angle as a person wrote it: 30, not 29.999999999999996."""
    return round(math.degrees(radians), 9)


@jax.jit
def _semi_minor(geometry: Geometry, c: jax.Array, d: jax.Array) -> jax.Array:
    forward = partial(_at_geometry, optics.exact_semi_minor, geometry)
    return jax.vmap(lambda c, d: forward(eccentricity=c, distance=d))(c, d)


@jax.jit
def _estimates(geometry: Geometry, c: jax.Array, semi_minor_px: jax.Array) -> dict[str, jax.Array]:
    known: dict[str, Any] = {
        "semi_minor_px": semi_minor_px,
        "scale": geometry.scale,
        "k": optics.slope(geometry.half_angle),
        "b": geometry.apex_offset,
        "eccentricity": c,
        "eye_radius": geometry.eye_radius,
    }
    kappa = 1.0 / (geometry.pinhole_height + geometry.eye_radius)
    exact = partial(_at_geometry, optics.exact_distance, geometry)
    on_a_plane = {name: known[name] for name in ("semi_minor_px", "scale", "k", "b")}
    return {
        "planar": optics.planar_distance(**on_a_plane),
        "small_plane": optics.small_plane_distance(**known),
        "corrected": optics.corrected_distance(**known, inverse_working_distance=kappa),
        "stereographic": optics.stereographic_distance(**known),
        "exact": jax.vmap(lambda c, e: exact(eccentricity=c, semi_minor_px=e))(c, semi_minor_px),
    }


def _at_geometry(
    function: Callable[..., jax.Array], geometry: Geometry, **arguments: jax.Array
) -> jax.Array:
    return function(
        optics.Sphere(geometry.eye_radius),
        optics.microscope(
            scale=geometry.scale,
            pinhole_height=geometry.pinhole_height,
            eye_radius=geometry.eye_radius,
        ),
        incidence=geometry.incidence,
        incidence_azimuth=geometry.incidence_azimuth,
        half_angle=geometry.half_angle,
        apex_offset=geometry.apex_offset,
        **arguments,
    )
