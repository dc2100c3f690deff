"""Distance from the exact contour: by its semi-minor axis, or by its area for a known axis."""

import equinox as eqx
import jax.numpy as jnp
import optimistix as optx
from jaxtyping import Array, Float, ScalarLike

from eyespot.optics.beam import Beam, beam_at_spot
from eyespot.optics.camera import Camera
from eyespot.optics.contour import FEW_POINTS, spot_ellipse
from eyespot.optics.ellipse import Ellipse
from eyespot.optics.surface import Surface

_ITERATION: optx.AbstractFixedPointSolver = optx.FixedPointIteration(rtol=1e-11, atol=1e-11)
_MOST_STEPS = 12
"""Each step reduces the error to about 5 %, so 12 steps reach rounding."""


def exact_semi_minor(surface: Surface, microscope: Camera, **beam: ScalarLike) -> Float[Array, ""]:
    """e1' of the exact contour, px.

    Args:
        beam: arguments of `beam_at_spot`, mm and rad.
    """
    return spot_ellipse(beam_at_spot(surface, **beam), surface, microscope).semi_minor


def exact_distance(
    surface: Surface,
    microscope: Camera,
    *,
    semi_minor_px: ScalarLike,
    half_angle: ScalarLike,
    apex_offset: ScalarLike,
    **spot: ScalarLike,
) -> Float[Array, ""]:
    """Distance d = |SO| (mm) from e1' (px) for a known spot position and beam direction.

    The contour's size is nearly proportional to the distance d - b from the apex. So each step
    multiplies d - b by measured over expected size. It reduces the error to the effect of the
    wall's curvature on the spot's size (R/r, about 5 %).

    Args:
        semi_minor_px: e1', px.
        half_angle: alpha of the cone, rad.
        apex_offset: b, mm.
        spot: other arguments of `beam_at_spot`, mm and rad.

    Example:
        >>> from eyespot import optics
        >>> eye = optics.Sphere(11.5)
        >>> view = optics.microscope(scale=0.0067, pinhole_height=200.0, eye_radius=11.5)
        >>> cone = {"half_angle": 0.0499584, "apex_offset": -5.117}
        >>> seen = exact_semi_minor(eye, view, distance=2.0, eccentricity=3.0, **cone)
        >>> found = exact_distance(eye, view, semi_minor_px=seen, eccentricity=3.0, **cone)
        >>> round(float(found), 6)
        2.0
    """
    spot |= {"half_angle": half_angle, "apex_offset": apex_offset}

    def rescaled(distance: Float[Array, ""], _: None) -> Float[Array, ""]:
        seen = exact_semi_minor(surface, microscope, distance=distance, **spot)
        return apex + (distance - apex) * semi_minor_px / seen

    apex = jnp.asarray(apex_offset, float)
    planar = apex + microscope.scale * semi_minor_px / jnp.tan(half_angle)
    # A fixed point rather than a root by Newton's method, which needs the contour's derivative at
    # every step: in batches of 1024 this takes 60 us a spot and Newton 286, and both end within
    # 1e-13 mm of the distance.
    return optx.fixed_point(rescaled, _ITERATION, planar, max_steps=_MOST_STEPS, throw=False).value


@eqx.filter_jit
def distance_by_area(
    ellipse: Ellipse,
    surface: Surface,
    camera: Camera,
    *,
    axis: Float[Array, "3"],
    half_angle: ScalarLike,
    apex_offset: ScalarLike,
) -> Float[Array, ""]:
    """Distance d = |SO| (mm) at which the exact spot has the centre and the area of an ellipse.

    The beam's axis is known, from the robot. Foreshortening along one direction changes the area
    less than it changes the semi-minor axis, so the area depends less on how exactly camera and
    wall are known. Each step shifts the spot by the centre's error and multiplies d - b by the
    square root of measured over expected area, as in `exact_distance`.

    Args:
        ellipse: measured, px; its angle and the ratio of its axes have no effect.
        axis: unit vector of the beam from the tip towards the wall.
        half_angle: of the cone, rad.
        apex_offset: b, mm.
    """
    size = ellipse.size(by_area=True)
    apex = jnp.asarray(apex_offset, float)

    def improved(guess: tuple[Array, Array], _: None) -> tuple[Array, Array]:
        pixel, distance = guess
        spot = surface.intersect(*camera.ray(pixel)).point
        beam = Beam(
            tip=spot - distance * axis, axis=axis, half_angle=half_angle, apex_offset=apex_offset
        )
        seen = spot_ellipse(beam, surface, camera, points=FEW_POINTS)
        grown = size / seen.size(by_area=True)
        return pixel + ellipse.centre - seen.centre, apex + (distance - apex) * grown

    start = ellipse.centre, apex + camera.scale * size / jnp.tan(half_angle)
    found: optx.Solution = optx.fixed_point(
        improved, _ITERATION, start, max_steps=_MOST_STEPS, throw=False
    )
    return found.value[1]
