"""How far each model of the spot is from the truth, on exact contours and on measured spots."""

import math
from collections.abc import Sequence
from functools import partial
from typing import Any, Literal, NamedTuple

import jax
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from eyespot import optics
from eyespot.benchmarks import reporting as page
from eyespot.benchmarks.paper import ACCEPTABLE_ERROR_MM, first_reached, largest
from eyespot.scenes import Scene
from eyespot.scenes.world.world import World

COMPARED = ("small_plane", "corrected", "stereographic", "exact")
"""The models of a spot in an eyeball; `planar` is one of a plane."""


_Values = jax.Array | np.ndarray


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
    "model source refit medium c_mm d_mm r_mm z_f_mm incidence_deg azimuth_deg half_angle_deg "
    "apex_offset_mm estimate_mm error_mm"
).split()
"""Columns of model_error.csv; error = estimate - truth.

`azimuth_deg` is the incidence's, counted from the meridian of O; `refit`: c was fitted to the
spots, as the paper does, and `c_mm` is the true one.
"""


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


def exact_spots(
    geometry: Geometry, *, eccentricities: ArrayLike, distances: ArrayLike, medium: str = "air"
) -> pd.DataFrame:
    """Spots for `model_errors` at each c and d (mm), of the size of the exact contour."""
    c, d = (a.ravel() for a in np.meshgrid(eccentricities, distances, indexing="ij"))
    seen = np.asarray(semi_minor(geometry, c=c, d=d))
    return pd.DataFrame({"c_mm": c, "d_mm": d, "semi_minor_px": seen, "medium": medium})


def model_errors(
    geometry: Geometry,
    spots: pd.DataFrame,
    *,
    source: Literal["analytic", "rendered"],
    models: Sequence[str] = COMPARED,
) -> pd.DataFrame:
    """Errors of the models on spots whose truth is known, and whose c they are given.

    Args:
        spots: columns c_mm, d_mm, semi_minor_px and medium: `exact_spots`, or those of
            `paper.spots_of` that are used.
    """
    c, d, e = spots[["c_mm", "d_mm", "semi_minor_px"]].to_numpy(float).T
    about = {"source": source, "refit": False, "medium": spots.medium.iloc[0]}
    about |= place(geometry, c=c, d=d)
    found = jax.tree.map(np.asarray, estimates(geometry, c=c, semi_minor_px=e))
    tables = [
        pd.DataFrame({"model": m, **about, "estimate_mm": found[m], "error_mm": found[m] - d})
        for m in models
    ]
    return pd.concat(tables, ignore_index=True)


@jax.jit
def semi_minor(geometry: Geometry, *, c: _Values, d: _Values) -> jax.Array:
    """e1' of the exact contour at eccentricities and distances (mm), px."""
    forward = partial(optics.exact_semi_minor, *geometry.world, **geometry.beam)
    return jax.vmap(lambda c, d: forward(eccentricity=c, distance=d))(c, d)


@jax.jit
def estimates(geometry: Geometry, *, c: _Values, semi_minor_px: _Values) -> dict[str, jax.Array]:
    """Distance by every model, mm, from e1' (px) at known eccentricity (mm)."""
    exact = partial(optics.exact_distance, *geometry.world, **geometry.beam)
    closed = partial(
        optics.closed_form_distance,
        semi_minor_px=semi_minor_px,
        scale=geometry.scale,
        k=optics.slope(geometry.half_angle),
        b=geometry.apex_offset,
        eccentricity=c,
        eye_radius=geometry.eye_radius,
        inverse_working_distance=1.0 / (geometry.pinhole_height + geometry.eye_radius),
    )
    return {model: closed(model) for model in optics.CLOSED_FORMS} | {
        "exact": jax.vmap(lambda c, e: exact(eccentricity=c, semi_minor_px=e))(c, semi_minor_px)
    }


def accuracy(errors: pd.DataFrame) -> pd.DataFrame:
    """Each model's errors over all spots by pinhole height and azimuth of the incidence."""
    by_geometry = errors.groupby(["model", "z_f_mm", "azimuth_deg"], sort=False).error_mm
    found = by_geometry.agg(spots="size", mean_error_mm="mean", max_abs_error_mm=largest)
    return found.reset_index()


def largest_errors(errors: pd.DataFrame) -> pd.Series:
    """The largest absolute error over all distances, by eccentricity; mm."""
    return errors.error_mm.abs().groupby(errors.c_mm.round(6)).max()


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

MODEL_COLOURS = dict(
    zip(COMPARED, (page.VERMILION, page.BLUE, page.GREEN, page.BLACK), strict=True)
)
TRIAL_COLOURS = (page.BLUE, page.ORANGE, page.GREEN)

READING = "$d_r$, reading since contact (mm)"
MEASURED = "measured $e_1'$ (px)"
DISTANCE = "$d$, tip to wall along the beam (mm)"
ECCENTRICITY = "eccentricity $c$ (mm)"

_SHADES = dict(zip(CHOSEN_DISTANCES_MM, ("#A6CEE3", page.SKY, page.BLUE, "#08306B"), strict=True))


def pinhole_title(z_f_mm: float) -> str:
    """The pinhole's height, for titles and legends."""
    return "telecentric" if np.isinf(z_f_mm) else f"$z_F$ = {z_f_mm:g} mm"


def model_error_figure(analytic: pd.DataFrame, rendered: pd.DataFrame) -> Figure:
    """Signed error against c: a row for each pinhole, a column for each of the models `SHOWN`.

    Tilted beams are shown at the first azimuth of their tilt.
    """
    tilted = analytic.incidence_deg.max()
    leaning = analytic[analytic.incidence_deg == tilted]
    square = analytic[analytic.incidence_deg != tilted]
    azimuth = leaning.azimuth_deg.iloc[0]

    def draw(axes: Axes, height: float, model: str) -> None:
        page.limit_lines(axes, ACCEPTABLE_ERROR_MM)
        for d, colour in _SHADES.items():
            for errors, style in (
                (square, {"ls": ":"}),
                (leaning, {"label": f"exact contour, $d$ = {d:g} mm"}),
                (rendered, {"ls": "", "marker": "o", "ms": 3.5}),
            ):
                here = (errors.model == model) & (errors.z_f_mm == height)
                if errors is not square:
                    here &= (errors.incidence_deg == tilted) & (errors.azimuth_deg == azimuth)
                shown = errors[here & ((errors.d_mm - d).abs() < 1e-6)]
                axes.plot(shown.c_mm, shown.error_mm, color=colour, **style)

    return page.small_multiples(
        draw,
        rows=rendered.z_f_mm.unique().tolist() or leaning.z_f_mm.unique().tolist()[:2],
        columns=SHOWN,
        title=lambda height, model: f"{model}\n{pinhole_title(height)}, azimuth {azimuth:g}°",
        x=ECCENTRICITY,
        y="estimate − $d$ (mm)",
        sharex=True,
        sharey="row",
    )
