"""Spots on exact contours and what every model reads there, in JAX."""

import math
from collections.abc import Sequence
from functools import partial
from typing import Literal

import jax
import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from eyespot import optics
from eyespot.benchmarks.model_error import COMPARED, Geometry, place
from eyespot.scenes import Scene
from eyespot.scenes.world.world import World

_Values = jax.Array | np.ndarray


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
