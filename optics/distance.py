"""`exact`: the distance whose exact contour has the measured semi-minor axis."""

from __future__ import annotations

from functools import partial

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, ScalarLike

from optics.beam import beam_at_spot
from optics.camera import Microscope
from optics.contour import spot_ellipse
from optics.surface import Surface

_STEPS = 12


def exact_semi_minor(
    surface: Surface,
    microscope: Microscope,
    *,
    distance: ScalarLike,
    eccentricity: ScalarLike,
    azimuth: ScalarLike = 0.0,
    incidence: ScalarLike = 0.0,
    incidence_azimuth: ScalarLike = 0.0,
    half_angle: ScalarLike,
    apex_offset: ScalarLike,
) -> Float[Array, ""]:
    """e1' of the exact contour, px; arguments as `beam_at_spot`, in mm and rad."""
    beam = beam_at_spot(
        surface,
        eccentricity=eccentricity,
        distance=distance,
        azimuth=azimuth,
        incidence=incidence,
        incidence_azimuth=incidence_azimuth,
        half_angle=half_angle,
        apex_offset=apex_offset,
    )
    return spot_ellipse(beam, surface, microscope).semi_minor


def exact_distance(
    surface: Surface,
    microscope: Microscope,
    *,
    semi_minor_px: ScalarLike,
    eccentricity: ScalarLike,
    azimuth: ScalarLike = 0.0,
    incidence: ScalarLike = 0.0,
    incidence_azimuth: ScalarLike = 0.0,
    half_angle: ScalarLike,
    apex_offset: ScalarLike,
) -> Float[Array, ""]:
    """Distance from a semi-minor axis where spot position and beam direction are known.

    The contour's size is nearly proportional to the distance d - b from the apex. So d - b is
    multiplied by measured over expected size, 12 times; each step reduces the error to the share
    that the wall's curvature has in the spot's size (R/r, some 5 %).

    Args:
        surface: the wall.
        microscope: the camera.
        semi_minor_px: e1', px.
        eccentricity: c of O, mm.
        azimuth: of O, rad.
        incidence: iota, rad.
        incidence_azimuth: rad.
        half_angle: rad.
        apex_offset: b, mm.

    Returns:
        d = |SO|, mm.
    """
    forward = partial(
        exact_semi_minor,
        surface,
        microscope,
        eccentricity=eccentricity,
        azimuth=azimuth,
        incidence=incidence,
        incidence_azimuth=incidence_azimuth,
        half_angle=half_angle,
        apex_offset=apex_offset,
    )

    # Not Optimistix's Newton: it takes 1.7 times as long a spot in batches of 1024 (it needs the
    # contour's derivative at every step), four times as long to compile, and ends in the same
    # number to 2e-14 mm. A loop of fixed length can also be differentiated forwards.
    def rescale(_: int, distance: Float[Array, ""]) -> Float[Array, ""]:
        return apex + (distance - apex) * semi_minor_px / forward(distance=distance)

    apex = jnp.asarray(apex_offset, float)
    planar = apex + microscope.scale * semi_minor_px / jnp.tan(half_angle)
    return jax.lax.fori_loop(0, _STEPS, rescale, planar)
