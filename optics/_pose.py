r"""Tip and axis of the beam from one contour: five parameters, their covariance, and the mirror.

An image point is a line of sight; where it meets the wall is known. So a contour gives wall points
X, and the cone through them obeys, with apex A and half-angle $\alpha$,

$$ |(X - A)_\perp| \cos\alpha - (X - A)\cdot\mathbf u \, \sin\alpha = 0, $$

the signed distance of X from the cone. Divided by its gradient in the image it is the point's
distance from the contour in px (Sampson 1982), without tracing any contour. Gauss-Newton steps with
Levenberg's damping minimise it.
"""

from __future__ import annotations

from functools import partial
from operator import itemgetter
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, ScalarLike

from optics._beam import perpendicular_frame
from optics._camera import Microscope
from optics._cholesky import solve_cholesky
from optics._ellipse import ellipse_of_contour
from optics._surface import Surface

_STEPS = 40
_SMALLEST_STEP = 1e-13
_UNOBSERVED = 1e-14
_HELD = 1e-7
"""Width of the prior that holds a known axis, rad: 1e-6 mm at the tip."""
_OBSERVABLE_AXIS_ERROR = np.radians(2.0)
"""Largest standard error of the axis, rad, for which its direction counts as observed."""


class DirectionPrior(NamedTuple):
    """What is known of the axis beforehand, from the robot or from the last frame.

    Attributes:
        axis: unit vector.
        sigma: standard deviation across it, rad.
    """

    axis: Float[Array, "3"]
    sigma: ScalarLike


class Pose(NamedTuple):
    """One solution.

    Attributes:
        tip: S, mm.
        axis: unit vector.
        distance: d = |SO|, mm.
        covariance: of (tip x, y, z in mm; axis along its two perpendiculars in rad).
        distance_error: standard error of d, mm.
        misfit_px: root mean square distance of the points from the contour, px.
        cost: sum of squares over sigma, prior included; ranks solutions.
    """

    tip: Float[Array, "3"]
    axis: Float[Array, "3"]
    distance: Float[Array, ""]
    covariance: Float[Array, "5 5"]
    distance_error: Float[Array, ""]
    misfit_px: Float[Array, ""]
    cost: Float[Array, ""]


class PoseEstimate(NamedTuple):
    """The better solution, its mirror (incidence reversed), and what can be told.

    Attributes:
        best: the solution of least cost.
        mirror: the other one; the same where both starts end in one place.
        observable: whether the direction is determined better than 2 degrees; near square
            incidence it is not, while the distance still is.
    """

    best: Pose
    mirror: Pose
    observable: Bool[Array, ""]


@eqx.filter_jit
def pose_from_contour(
    contour: Float[Array, "n 2"],
    surface: Surface,
    microscope: Microscope,
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
    starts = _starts(data)
    both = jax.vmap(partial(_refined, data, prior))(*starts)
    first, second = (jax.tree.map(itemgetter(k), both) for k in (0, 1))
    swap = second.cost < first.cost
    best, mirror = (
        jax.tree.map(lambda a, b: jnp.where(swap, b, a), first, second),
        jax.tree.map(lambda a, b: jnp.where(swap, a, b), first, second),
    )
    axis_error = jnp.sqrt(jnp.linalg.norm(best.covariance[3:, 3:], ord=2))
    return PoseEstimate(best, mirror, axis_error < _OBSERVABLE_AXIS_ERROR)


@eqx.filter_jit
def tip_from_contour(
    contour: Float[Array, "n 2"],
    surface: Surface,
    microscope: Microscope,
    *,
    axis: Float[Array, "3"],
    half_angle: ScalarLike,
    apex_offset: ScalarLike,
    sigma_px: ScalarLike,
) -> Pose:
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
    tips, axes = _starts(data)
    distance = jnp.dot(data.centre - tips[0], axes[0])
    # A prior of no width holds the axis; the solution is that of three parameters.
    return _refined(data, DirectionPrior(axis, _HELD), data.centre - distance * axis, axis)


class _Seen(NamedTuple):
    """What does not depend on the pose, computed once."""

    points: Float[Array, "n 3"]
    """Wall points of the contour, mm."""
    steps: Float[Array, "n 3 2"]
    """How they move with the pixel, mm per px."""
    centre: Float[Array, "3"]
    outward: Float[Array, "3"]
    surface: Surface
    half_angle: Float[Array, ""]
    apex_offset: Float[Array, ""]
    sigma_px: Float[Array, ""]


def _seen(contour, surface, microscope, half_angle, apex_offset, sigma_px) -> _Seen:
    def on_wall(pixel):
        return surface.intersect(*microscope.ray(pixel)).point

    points = on_wall(contour)
    outward = -jnp.mean(surface.intersect(*microscope.ray(contour)).normal, axis=0)
    return _Seen(
        points=points,
        steps=jax.vmap(jax.jacfwd(on_wall))(contour),
        centre=jnp.mean(points, axis=0),
        outward=outward / jnp.linalg.norm(outward),
        surface=surface,
        half_angle=jnp.asarray(half_angle, float),
        apex_offset=jnp.asarray(apex_offset, float),
        sigma_px=jnp.asarray(sigma_px, float),
    )


def _starts(data: _Seen) -> tuple[Float[Array, "2 3"], Float[Array, "2 3"]]:
    """Tips and axes of the two beams that a tilted plane would give.

    Its spot has cos(incidence) = minor/major, leaning either way along the major axis.
    """
    first, second = perpendicular_frame(data.outward)
    apart = data.points - data.centre
    ellipse = ellipse_of_contour(jnp.stack([apart @ first, apart @ second], axis=-1))
    along = jnp.cos(ellipse.angle) * first + jnp.sin(ellipse.angle) * second
    # An exactly square start would stay square: both lean by 3 degrees at least.
    cosine = jnp.minimum(ellipse.semi_minor / ellipse.semi_major, np.cos(np.radians(3.0)))
    sine = jnp.sqrt(1.0 - cosine**2)
    axes = jnp.stack([cosine * data.outward + side * sine * along for side in (1.0, -1.0)])
    distance = ellipse.semi_minor / jnp.tan(data.half_angle) + data.apex_offset
    return data.centre - distance * axes, axes


def _refined(data: _Seen, prior: DirectionPrior | None, tip, axis) -> Pose:
    """Damped Gauss-Newton from a start until the steps are lost in rounding."""

    def residual(step, tip, axis, per_px):
        moved_tip, moved_axis = _moved(step, tip, axis)
        parts = [_from_cone(data, moved_tip, moved_axis)[0] * per_px / data.sigma_px]
        if prior is not None:
            parts.append(jnp.cross(moved_axis, prior.axis) / prior.sigma)
        return jnp.concatenate(parts)

    zero = jnp.zeros(5)

    def linear(tip, axis):
        # The gradient's length hardly moves with the pose: it is taken as constant in a step.
        per_px = 1.0 / _from_cone(data, tip, axis)[1]
        value = residual(zero, tip, axis, per_px)
        jacobian = jax.jacfwd(residual)(zero, tip, axis, per_px)
        return jnp.sum(value**2), jacobian.T @ jacobian, jacobian.T @ value

    def going_on(state):
        count, _, _, _, _, length = state
        return (count < _STEPS) & (length > _SMALLEST_STEP)

    def iterate(state):
        count, tip, axis, damping, (cost, normal, gradient), _ = state
        step = -_solve(normal + damping * jnp.diag(jnp.diag(normal)), gradient)
        moved = _moved(step, tip, axis)
        system = linear(*moved)
        better = system[0] <= cost
        kept = jax.tree.map(
            lambda new, old: jnp.where(better, new, old),
            (*moved, system),
            (tip, axis, (cost, normal, gradient)),
        )
        damping = jnp.clip(jnp.where(better, 0.1, 10.0) * damping, 1e-15, 1e3)
        return count + 1, kept[0], kept[1], damping, kept[2], jnp.linalg.norm(step)

    start = (0, tip, axis, jnp.asarray(1e-3), linear(tip, axis), jnp.asarray(1.0))
    _, tip, axis, _, (cost, normal, _), _ = jax.lax.while_loop(going_on, iterate, start)
    covariance = _covariance(normal)

    def distance(step):
        return data.surface.intersect(*_moved(step, tip, axis)).distance

    gradient = jax.grad(distance)(zero)
    value, slope = _from_cone(data, tip, axis)
    return Pose(
        tip=tip,
        axis=axis,
        distance=distance(zero),
        covariance=covariance,
        distance_error=jnp.sqrt(gradient @ covariance @ gradient),
        misfit_px=jnp.sqrt(jnp.mean(jnp.square(value / slope))),
        cost=cost,
    )


def _moved(step, tip, axis):
    """Tip shifted by mm, axis turned by rad along its two perpendiculars."""
    first, second = perpendicular_frame(axis)
    turned = axis + step[3] * first + step[4] * second
    return tip + step[:3], turned / jnp.linalg.norm(turned)


def _from_cone(data: _Seen, tip, axis):
    """Signed distance of the wall points from the cone, mm, and its gradient, mm per px."""
    cos_a, sin_a = jnp.cos(data.half_angle), jnp.sin(data.half_angle)
    offset = data.points - (tip + data.apex_offset * axis)
    along = offset @ axis
    across = offset - along[:, None] * axis
    radius = jnp.linalg.norm(across, axis=-1)
    normal = across / radius[:, None] * cos_a - sin_a * axis
    slope = jnp.einsum("nk,nkp->np", normal, data.steps)
    return radius * cos_a - along * sin_a, jnp.linalg.norm(slope, axis=-1)


def _covariance(normal: Float[Array, "5 5"]) -> Float[Array, "5 5"]:
    """Inverse of the normal matrix; directions that nothing observes get a huge variance."""
    scale = jnp.sqrt(jnp.diag(normal))
    values, vectors = jnp.linalg.eigh(normal / (scale * scale[:, None]))
    inverse = (vectors / jnp.maximum(values, _UNOBSERVED)) @ vectors.T
    return inverse / (scale * scale[:, None])


def _solve(matrix: Float[Array, "5 5"], target: Float[Array, "5"]) -> Float[Array, "5"]:
    rows = [[matrix[i, j] for j in range(i + 1)] for i in range(target.size)]
    return jnp.stack(solve_cholesky(rows, list(target)))
