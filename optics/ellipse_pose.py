r"""Tip and axis of the beam from a measured ellipse: five numbers for five parameters.

The contour is a quartic curve, not an ellipse: the pose sought is the one whose contour's *fitted*
ellipse (`ellipse_of_contour`) is the measured one, not the one whose contour runs through the
measured ellipse's points.
"""

from __future__ import annotations

from functools import partial

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float, ScalarLike

from optics.beam import Beam, generator_angles
from optics.camera import Camera
from optics.contour import spot_contour
from optics.ellipse import Ellipse, ellipse_points
from optics.mismatch import ellipse_mismatch, mismatch_covariance
from optics.pose import (
    DirectionPrior,
    PoseEstimate,
    best_and_mirror,
    leaning_either_way,
    refined_pose,
)
from optics.surface import Surface

_POINTS = 32
"""A quarter of the usual, for a quarter of the time: 1e-7 px."""


@eqx.filter_jit
def pose_from_ellipse(
    ellipse: Ellipse,
    surface: Surface,
    microscope: Camera,
    *,
    covariance: Float[Array, "5 5"],
    half_angle: ScalarLike,
    apex_offset: ScalarLike,
    prior: DirectionPrior | None = None,
) -> PoseEstimate:
    """Tip and axis of the beam whose spot has the measured ellipse.

    Args:
        ellipse: measured, px.
        surface: the wall.
        microscope: the camera.
        covariance: of (centre u, centre v, semi-major, semi-minor in px; angle in rad).
        half_angle: of the cone, rad.
        apex_offset: b, mm.
        prior: of the direction; tells the mirror solution, which has the same ellipse or almost
            the same, from the true one.
    """
    points = ellipse_points(ellipse, jnp.asarray(generator_angles(_POINTS)))
    met = surface.intersect(*microscope.ray(points))
    starts = leaning_either_way(met.point, -jnp.mean(met.normal, axis=0), half_angle, apex_offset)
    whitening = jnp.linalg.inv(jnp.linalg.cholesky(mismatch_covariance(ellipse, covariance)))

    def mismatch(tip, axis):
        beam = Beam(tip=tip, axis=axis, half_angle=half_angle, apex_offset=apex_offset)
        return ellipse_mismatch(spot_contour(beam, surface, microscope, points=_POINTS), ellipse)

    def misfit_px(tip, axis):
        # Mean squares of 1, cos and sin over the ellipse's angle.
        mean_squares = jnp.array([0.5, 0.5, 1.0, 0.5, 0.5])
        return ellipse.semi_minor * jnp.sqrt(jnp.sum(mean_squares * mismatch(tip, axis) ** 2))

    return best_and_mirror(
        partial(
            refined_pose,
            lambda tip, axis: whitening @ mismatch(tip, axis),
            misfit_px,
            surface,
            prior,
        ),
        starts,
    )
