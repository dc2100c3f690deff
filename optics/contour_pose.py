r"""Tip and axis of the beam from the image of the spot's edge.

An image point defines a line of sight, whose intersection with the wall is known. So a contour
gives wall points X. The cone through them, with apex A and half-angle $\alpha$, obeys

$$ |(X - A)_\perp| \cos\alpha - (X - A)\cdot\mathbf u \, \sin\alpha = 0, $$

where the left side is the signed distance of X from the cone. Divided by its gradient in the image
it is the point's distance from the contour in px (Sampson 1982); no contour needs to be computed.
"""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, ScalarLike

from optics.camera import Camera
from optics.pose import (
    BeamPose,
    DirectionPrior,
    PoseEstimate,
    best_and_mirror,
    leaning_either_way,
    refined_pose,
)
from optics.surface import Surface
from optics.vector import dot

_HELD = 1e-7
"""Standard deviation of the prior that fixes a known axis, rad: 1e-6 mm at the tip."""


@eqx.filter_jit
def pose_from_contour(
    contour: Float[Array, "n 2"],
    surface: Surface,
    microscope: Camera,
    *,
    half_angle: ScalarLike,
    apex_offset: ScalarLike,
    sigma_px: ScalarLike,
    prior: DirectionPrior | None = None,
) -> PoseEstimate:
    """Tip and axis from the image of the spot's edge.

    Args:
        contour: points round the edge, px, in order; not necessarily a whole turn.
        surface: the wall.
        microscope: the camera.
        half_angle: of the cone, rad.
        apex_offset: b, mm.
        sigma_px: standard deviation of a point across the contour, px.
        prior: of the direction; tells the mirror solution from the true one.
    """
    data = _seen(contour, surface, microscope, half_angle, apex_offset, sigma_px)
    starts = leaning_either_way(data.points, data.outward, half_angle, apex_offset)
    return best_and_mirror(partial(_refined, data, prior), starts)


@eqx.filter_jit
def tip_from_contour(
    contour: Float[Array, "n 2"],
    surface: Surface,
    microscope: Camera,
    *,
    axis: Float[Array, "3"],
    half_angle: ScalarLike,
    apex_offset: ScalarLike,
    sigma_px: ScalarLike,
) -> BeamPose:
    """Tip from the image of the spot's edge where the robot knows the axis.

    Args:
        contour: points round the edge, px.
        surface: the wall.
        microscope: the camera.
        axis: unit vector of the beam.
        half_angle: of the cone, rad.
        apex_offset: b, mm.
        sigma_px: standard deviation of a point across the contour, px.
    """
    data = _seen(contour, surface, microscope, half_angle, apex_offset, sigma_px)
    tips, axes = leaning_either_way(data.points, data.outward, half_angle, apex_offset)
    centre = jnp.mean(data.points, axis=0)
    distance = jnp.dot(centre - tips[0], axes[0])
    # A prior of no width holds the axis; the solution is that of three parameters.
    return _refined(data, DirectionPrior(axis, _HELD), centre - distance * axis, axis)


class _Seen(NamedTuple):
    """What does not depend on the pose, computed once."""

    points: Float[Array, "n 3"]
    """Wall points of the contour, mm."""
    steps: Float[Array, "n 3 2"]
    """How they move with the pixel, mm per px."""
    outward: Float[Array, "3"]
    surface: Surface
    half_angle: Float[Array, ""]
    apex_offset: Float[Array, ""]
    sigma_px: Float[Array, ""]


def _seen(contour, surface, microscope, half_angle, apex_offset, sigma_px) -> _Seen:
    def on_wall(pixel):
        return surface.intersect(*microscope.ray(pixel)).point

    met = surface.intersect(*microscope.ray(contour))
    return _Seen(
        points=met.point,
        steps=jax.vmap(jax.jacfwd(on_wall))(contour),
        outward=-jnp.mean(met.normal, axis=0),
        surface=surface,
        half_angle=jnp.asarray(half_angle, float),
        apex_offset=jnp.asarray(apex_offset, float),
        sigma_px=jnp.asarray(sigma_px, float),
    )


def _refined(data: _Seen, prior: DirectionPrior | None, tip, axis) -> BeamPose:
    def off_contour_px(tip, axis):
        value, slope = _from_cone(data, tip, axis)
        # The gradient's length hardly moves with the pose: a constant within a step.
        return value / jax.lax.stop_gradient(slope)

    return refined_pose(
        lambda tip, axis: off_contour_px(tip, axis) / data.sigma_px,
        lambda tip, axis: jnp.sqrt(jnp.mean(off_contour_px(tip, axis) ** 2)),
        data.surface,
        prior,
        tip,
        axis,
    )


def _from_cone(data: _Seen, tip, axis):
    """Signed distance of the wall points from the cone, mm, and its gradient, mm per px."""
    cos_a, sin_a = jnp.cos(data.half_angle), jnp.sin(data.half_angle)
    offset = data.points - (tip + data.apex_offset * axis)
    along = dot(offset, axis)
    across = offset - along[:, None] * axis
    radius = jnp.sqrt(dot(across, across))
    normal = across * (cos_a / radius)[:, None] - sin_a * axis
    slopes = [dot(normal, data.steps[..., k]) for k in range(2)]
    return radius * cos_a - along * sin_a, jnp.hypot(*slopes)
