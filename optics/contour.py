"""The exact spot: cone and wall intersected generator by generator, projected, fitted."""

from __future__ import annotations

import jax.numpy as jnp
from jaxtyping import Array, Float

from optics.beam import Beam, generator_angles
from optics.camera import Camera
from optics.ellipse import Ellipse, ellipse_of_contour
from optics.surface import Intersection, Surface

CONTOUR_POINTS = 128
"""Enough for 1e-9 px on every spot inside the working volume; the sums converge spectrally."""


def cone_contour(beam: Beam, surface: Surface, *, points: int = CONTOUR_POINTS) -> Intersection:
    """Edge of the lit spot on the wall: where the cone's generators meet it.

    Args:
        beam: the cone; its generators start at the virtual apex.
        surface: the wall.
        points: number of generators, uniform about the axis.

    Returns:
        Wall points in mm with a status each; for a sphere the curve is a quartic.
    """
    directions = beam.generators(jnp.asarray(generator_angles(points)))
    return surface.intersect(jnp.broadcast_to(beam.apex, directions.shape), directions)


def spot_contour(
    beam: Beam, surface: Surface, microscope: Camera, *, points: int = CONTOUR_POINTS
) -> Float[Array, "n 2"]:
    """Image of the spot's edge, px."""
    return microscope.project(cone_contour(beam, surface, points=points).point)


def spot_ellipse(
    beam: Beam, surface: Surface, microscope: Camera, *, points: int = CONTOUR_POINTS
) -> Ellipse:
    """Ellipse of the image of the spot's edge, px: the `exact` model, forward.

    Example:
        >>> import optics
        >>> eye = optics.Sphere(11.5)
        >>> view = optics.microscope(scale=0.0067, pinhole_height=200.0, eye_radius=11.5)
        >>> cone = {"half_angle": 0.0499584, "apex_offset": -5.117}
        >>> beam = optics.beam_at_spot(eye, eccentricity=3.0, distance=2.0, **cone)
        >>> round(float(optics.spot_ellipse(beam, eye, view).semi_minor), 2)
        51.53
    """
    return ellipse_of_contour(spot_contour(beam, surface, microscope, points=points))
