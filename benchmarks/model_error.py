"""Errors of the models on spots whose truth is known: geometry, readings, limits, looks."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from eyespot import optics
from eyespot.benchmarks import reporting as page
from eyespot.benchmarks.statistics import first_reached

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

    @property
    def world(self) -> tuple[optics.Sphere, optics.Microscope]:
        """The wall and the microscope."""
        microscope = optics.microscope(
            scale=self.scale, pinhole_height=self.pinhole_height, eye_radius=self.eye_radius
        )
        return optics.Sphere(self.eye_radius), microscope

    @property
    def beam(self) -> dict[str, Any]:
        """The cone and its tilt, as arguments of `optics.beam_at_spot` and its like."""
        names = ("half_angle", "apex_offset", "incidence", "incidence_azimuth")
        return {name: getattr(self, name) for name in names}


MODEL_ERROR = (
    "model source medium c_mm d_mm r_mm z_f_mm incidence_deg azimuth_deg half_angle_deg "
    "apex_offset_mm estimate_mm error_mm"
).split()
"""Columns of model_error.csv; error = estimate - truth.

`azimuth_deg` is the incidence's, counted from the meridian of O.
"""


# Exact contours, and what every model reads off a spot, in NumPy: JAX takes as long to import as
# a rig's errors take.

_STEPS = 8
"""Of the iteration for `exact`; each reduces the error to a tenth or less."""


def errors_of(
    geometry: Geometry,
    models: Sequence[str],
    *,
    c: np.ndarray,
    d: np.ndarray,
    semi_minor_px: np.ndarray | None = None,
    **about: Any,
) -> pd.DataFrame:
    """What models read off spots, minus the truth: a row for each model and spot.

    Args:
        c: true eccentricities, mm, which the models are given.
        d: true distances, mm.
        semi_minor_px: of the spots; by default those of their exact contours.
        about: values of further columns.
    """
    if semi_minor_px is None:
        semi_minor_px = exact_spots(geometry, c=c, d=d).semi_minor
    found = readings(geometry, models, c=c, semi_minor_px=semi_minor_px)
    about |= place(geometry, c=c, d=d)
    tables = [
        pd.DataFrame({"model": model, **about, "estimate_mm": own, "error_mm": own - d})
        for model, own in found.items()
    ]
    return pd.concat(tables, ignore_index=True)


def errors_of_spots(geometry: Geometry, spots: pd.DataFrame, models: Sequence[str]) -> pd.DataFrame:
    """Errors of models on measured spots: `paper.spots_of`, those that are used."""
    c, d, e = spots[["c_mm", "d_mm", "semi_minor_px"]].to_numpy(float).T
    about: dict[str, Any] = {"source": "rendered", "medium": spots.medium.iloc[0]}
    return errors_of(geometry, models, c=c, d=d, semi_minor_px=e, **about)


def readings(
    geometry: Geometry, models: Sequence[str], *, c: np.ndarray, semi_minor_px: np.ndarray
) -> dict[str, np.ndarray]:
    """What models read off spots of known eccentricity (mm) and semi-minor axis (px), mm."""
    view = cone_view(geometry)
    closed: dict[str, Any] = {
        "semi_minor_px": semi_minor_px,
        "scale": view.scale,
        "k": view.k,
        "b": view.b,
        "eccentricity": c,
        "eye_radius": view.eye_radius,
        "inverse_working_distance": view.inverse_working_distance,
    }
    return {
        model: exact_distance(geometry, c=c, semi_minor_px=semi_minor_px)
        if model == "exact"
        else np.asarray(optics.closed_form_distance(model, **closed))
        for model in models
    }


def exact_distance(geometry: Geometry, *, c: np.ndarray, semi_minor_px: np.ndarray) -> np.ndarray:
    """Distance (mm) whose exact contour has this semi-minor axis: `optics.exact_distance`."""
    view = cone_view(geometry)
    apart = view.k * view.scale * semi_minor_px
    for _ in range(_STEPS):
        seen = exact_spots(geometry, c=c, d=view.b + apart).semi_minor
        apart = apart * semi_minor_px / seen
    return view.b + apart


def exact_spots(geometry: Geometry, *, c: np.ndarray, d: np.ndarray) -> optics.Ellipse:
    """Ellipses of the spots of beams at eccentricities and distances, mm, at azimuth 0."""
    spot, axis = places(geometry, c)
    return cone_view(geometry).spot_ellipse(spot=spot, axis=axis, distance=d)


def places(geometry: Geometry, c: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Spots O at eccentricities (mm) in the plane of x and z, and axes of the beams, (n, 3)."""
    sin_phi = c / geometry.eye_radius
    cos_phi, zero = np.sqrt(1.0 - sin_phi**2), np.zeros_like(c)
    outward = np.stack([sin_phi, zero, -cos_phi], axis=1)
    meridional = np.stack([cos_phi, zero, sin_phi], axis=1)
    azimuth = geometry.incidence_azimuth
    sideways = math.cos(azimuth) * meridional + math.sin(azimuth) * np.array([0.0, 1.0, 0.0])
    axis = math.cos(geometry.incidence) * outward + math.sin(geometry.incidence) * sideways
    return geometry.eye_radius * outward, axis


def cone_view(geometry: Geometry) -> optics.ConeView:
    """Cone, eye and pinhole in NumPy."""
    return optics.ConeView(
        k=1.0 / math.tan(geometry.half_angle),
        b=geometry.apex_offset,
        scale=geometry.scale,
        eye_radius=geometry.eye_radius,
        inverse_working_distance=1.0 / (geometry.pinhole_height + geometry.eye_radius),
    )


# Tables of errors.


def error_limits(errors: pd.DataFrame, tolerance: float) -> pd.DataFrame:
    """The smallest c (mm) at which each model's largest error over d reaches a tolerance (mm).

    Args:
        errors: of `eyespot.model_error`.

    Returns:
        A row for each model, tilt and azimuth; the azimuth is NaN for the worst one. c_mm is NaN if
        the tolerance is not reached.
    """
    keys = ["model", "incidence_deg", "azimuth_deg"]
    rows = [(*key, limit_eccentricity(own, tolerance)) for key, own in page.grouped(errors, *keys)]
    found = pd.DataFrame(rows, columns=[*keys, "c_mm"])
    worst = found.groupby(keys[:2], sort=False).c_mm.min().reset_index()
    return pd.concat([found, worst.assign(azimuth_deg=math.nan)], ignore_index=True)[
        [*keys, "c_mm"]
    ]


def largest_errors(errors: pd.DataFrame) -> pd.Series:
    """The largest absolute error over all distances, by eccentricity; mm.

    It is infinite where a model has no distance.
    """
    size = errors.error_mm.abs().fillna(math.inf)
    return size.groupby(errors.c_mm.round(6)).max()


def limit_eccentricity(errors: pd.DataFrame, limit: float) -> float:
    """Smallest c at which the largest error over all distances reaches the limit, mm.

    Linear between the eccentricities computed; NaN if the limit is never reached.
    """
    worst = largest_errors(errors)
    return first_reached(worst.index, worst, limit)


def place(geometry: Geometry, *, c: np.ndarray, d: np.ndarray) -> dict[str, Any]:
    """The columns of a CSV file for the places of spots and their geometry."""
    return {
        "c_mm": c,
        "d_mm": d,
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


# Figures.

CHOSEN_DISTANCES_MM = (0.5, 2.0, 4.0, 6.0)
SHOWN = ("small_plane", "corrected", "exact")
"""Models of figures that have a panel for each; the CSV files have all."""

COLOURS = {"planar": page.ORANGE} | dict(
    zip(COMPARED, (page.VERMILION, page.BLUE, page.GREEN, page.BLACK), strict=True)
)
_LEAST_MM, _MOST_MM = 1e-3, 12.0
"""Ends of a logarithmic axis of errors; smaller ones are drawn at its foot."""

READING = "$d_r$, reading since contact (mm)"
MEASURED = "measured $e_1'$ (px)"
DISTANCE = "$d$, tip to wall along the beam (mm)"
ECCENTRICITY = "eccentricity $c$ (mm)"


def draw_largest_errors(
    axes: Axes,
    exact: pd.DataFrame,
    measured: pd.DataFrame | None = None,
    *,
    models: Sequence[str] = tuple(COLOURS),
    limits: Sequence[float] = (),
) -> None:
    """Draw the largest error over d against c: lines on exact contours, marks on measured spots.

    With measured spots the line of `exact` is left out, which is right to rounding.
    """
    for limit in limits:
        axes.axhline(limit, color=page.GREY, lw=0.8, ls=":")
    for model in models:
        style: dict[str, Any] = {"color": COLOURS[model], "label": model}
        if measured is not None:
            marks = largest_errors(page.where(measured, model=model))
            axes.plot(marks, ls="", marker="o", ms=3.5, **style)
            style["label"] = None
        if measured is None or model != "exact":
            axes.plot(largest_errors(page.where(exact, model=model)), **style)
    axes.set(yscale="log", ylim=(_LEAST_MM, _MOST_MM))


def pinhole_title(z_f_mm: float) -> str:
    """The pinhole's height, for titles and legends."""
    return "telecentric" if np.isinf(z_f_mm) else f"$z_F$ = {z_f_mm:g} mm"
