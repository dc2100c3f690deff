r"""Tip and axis of the beam, from a measured ellipse or from the image of the spot's edge.

Two beams with opposite incidence explain a spot almost equally well. The solver starts from both
and ranks them.

An ellipse is five numbers for five parameters. The contour is a quartic curve, not an ellipse: the
pose sought is the one whose contour's *fitted* ellipse (`ellipse_of_contour`) is the measured one,
not the one whose contour runs through the measured ellipse's points.

An image point defines a line of sight, whose intersection with the wall is known. So a contour
gives wall points X. The cone through them, with apex A and half-angle $\alpha$, obeys

$$ |(X - A)_\perp| \cos\alpha - (X - A)\cdot\mathbf u \, \sin\alpha = 0, $$

where the left side is the signed distance of X from the cone. Divided by its gradient in the image
it is the point's distance from the contour in px (Sampson 1982); no contour needs to be computed.
"""

from collections.abc import Callable
from functools import partial
from operator import itemgetter
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, ScalarLike

from eyespot.optics.beam import Beam
from eyespot.optics.camera import Camera
from eyespot.optics.contour import FEW_POINTS, ellipse_mismatch, mismatch_covariance, spot_contour
from eyespot.optics.ellipse import Ellipse, ellipse_of_contour, ellipse_points
from eyespot.optics.lines import dot, generator_angles, perpendicular_frame
from eyespot.optics.surface import Intersection, Surface

_STEPS = 40
_DAMPING = 1e-3
_SMALLEST_STEP = 1e-11
_UNOBSERVED = 1e-14
_OBSERVABLE_AXIS_ERROR = np.radians(2.0)
"""Largest standard error of the axis, rad, for which its direction counts as observed."""

TipAndAxis = Callable[[Float[Array, "3"], Float[Array, "3"]], Float[Array, "*n"]]
"""A function of tip (mm) and axis (unit vector)."""


class DirectionPrior(NamedTuple):
    """Prior knowledge of the axis, from the robot or from the last frame.

    Attributes:
        axis: unit vector.
        sigma: standard deviation across it, rad.
    """

    axis: Float[Array, "3"]
    sigma: ScalarLike


class BeamPose(NamedTuple):
    """One solution.

    Attributes:
        tip: S, mm.
        axis: unit vector.
        distance: d = |SO|, mm.
        covariance: covariance of (tip x, y, z in mm; axis along its two perpendiculars in rad).
        distance_error: standard error of d, mm.
        cost: sum of squared residuals over sigma, prior included; ranks the solutions.
    """

    tip: Float[Array, "3"]
    axis: Float[Array, "3"]
    distance: Float[Array, ""]
    covariance: Float[Array, "5 5"]
    distance_error: Float[Array, ""]
    cost: Float[Array, ""]


class PoseEstimate(NamedTuple):
    """The better solution, its mirror (incidence reversed), and the direction's observability.

    Attributes:
        best: the solution with the least cost.
        mirror: the other solution; equal to `best` if both starts converge to one solution.
        observable: whether the direction is determined better than 2 degrees. Near perpendicular
            incidence it is not, although the distance still is.
    """

    best: BeamPose
    mirror: BeamPose
    observable: Bool[Array, ""]


def _leaning_either_way(
    met: Intersection, half_angle: ScalarLike, apex_offset: ScalarLike
) -> tuple[Float[Array, "2 3"], Float[Array, "2 3"]]:
    """Start values: tips and axes of the two beams that would make this spot on a plane.

    Such a spot has cos(incidence) = minor/major; the beam is tilted either way along the major
    axis. `met` has points of the spot's edge on the wall.
    """
    outward = -jnp.mean(met.normal, axis=0)
    outward = outward / jnp.linalg.norm(outward)
    first, second = perpendicular_frame(outward)
    centre = jnp.mean(met.point, axis=0)
    apart = met.point - centre
    ellipse = ellipse_of_contour(jnp.stack([dot(apart, first), dot(apart, second)], axis=-1))
    along = jnp.cos(ellipse.angle) * first + jnp.sin(ellipse.angle) * second
    # An exactly perpendicular start would remain so; both starts are tilted by 3 degrees at least.
    cosine = jnp.minimum(ellipse.semi_minor / ellipse.semi_major, np.cos(np.radians(3.0)))
    sine = jnp.sqrt(1.0 - cosine**2)
    axes = jnp.stack([cosine * outward + side * sine * along for side in (1.0, -1.0)])
    distance = ellipse.semi_minor / jnp.tan(half_angle) + apex_offset
    return centre - distance * axes, axes


def _best_and_mirror(
    solve: Callable[[Float[Array, "3"], Float[Array, "3"]], BeamPose],
    starts: tuple[Float[Array, "2 3"], Float[Array, "2 3"]],
) -> PoseEstimate:
    """Solve from two tips and axes, and rank the solutions by cost."""
    both = jax.vmap(solve)(*starts)
    # If a cone's apex is on the wall, its contour is a point, whose mismatch is always 0.
    ahead = jnp.where(both.distance > 0, both.cost, jnp.inf)
    first = (ahead[1] < ahead[0]).astype(int)
    best, mirror = (jax.tree.map(itemgetter(k), both) for k in (first, 1 - first))
    axis_error = jnp.sqrt(jnp.linalg.norm(best.covariance[3:, 3:], ord=2))
    return PoseEstimate(best, mirror, axis_error < _OBSERVABLE_AXIS_ERROR)


def _refined(
    residual: TipAndAxis,
    surface: Surface,
    prior: DirectionPrior | None,
    tip: Float[Array, "3"],
    axis: Float[Array, "3"],
) -> BeamPose:
    """Gauss-Newton with Marquardt's damping until the steps are below rounding.

    It adds a share of each state's own information. Optimistix adds one number to all, which is not
    the same for mm and rad. `residual` gives residuals over their standard deviation.
    """

    def residuals(step, tip, axis):
        tip, axis = _moved(step, tip, axis)
        if prior is None:
            return residual(tip, axis)
        return jnp.concatenate([residual(tip, axis), jnp.cross(axis, prior.axis) / prior.sigma])

    zero = jnp.zeros(5)

    def linear(tip, axis):
        value = residuals(zero, tip, axis)
        jacobian = jax.jacfwd(residuals)(zero, tip, axis)
        return jnp.sum(value**2), jacobian.T @ jacobian, jacobian.T @ value

    def going_on(state):
        count, _, _, _, _, length = state
        return (count < 2) | (count < _STEPS) & (length > _SMALLEST_STEP)

    def iterate(state):
        count, tip, axis, damping, (cost, normal, gradient), _ = state
        damped = normal + damping * jnp.diag(jnp.diag(normal))
        step = -jnp.linalg.solve(damped, gradient)
        moved = _moved(step, tip, axis)
        system = linear(*moved)
        better = system[0] <= cost
        kept = jax.tree.map(
            partial(jnp.where, better), (*moved, system), (tip, axis, (cost, normal, gradient))
        )
        damping = jnp.clip(jnp.where(better, 0.1, 10.0) * damping, 1e-15, 1e3)
        return count + 1, *kept[:2], damping, kept[2], jnp.linalg.norm(step)

    # The first round only computes the system at the start, so that `linear` is compiled once.
    unknown = (jnp.asarray(jnp.inf), jnp.eye(5), zero)
    start = (0, tip, axis, jnp.asarray(10 * _DAMPING), unknown, jnp.asarray(0.0))
    _, tip, axis, _, (cost, normal, _), _ = jax.lax.while_loop(going_on, iterate, start)
    # The normal matrix's inverse; unobserved directions get a very large variance.
    scale = jnp.sqrt(jnp.diag(normal))
    values, vectors = jnp.linalg.eigh(normal / (scale * scale[:, None]))
    inverse = (vectors / jnp.maximum(values, _UNOBSERVED)) @ vectors.T
    covariance = inverse / (scale * scale[:, None])

    def distance(step):
        return surface.intersect(*_moved(step, tip, axis)).distance

    gradient = jax.grad(distance)(zero)
    return BeamPose(
        tip=tip,
        axis=axis,
        distance=distance(zero),
        covariance=covariance,
        distance_error=jnp.sqrt(gradient @ covariance @ gradient),
        cost=cost,
    )


def _moved(step, tip, axis):
    """Tip shifted (mm) and axis turned along its two perpendiculars (rad)."""
    first, second = perpendicular_frame(axis)
    turned = axis + step[3] * first + step[4] * second
    return tip + step[:3], turned / jnp.linalg.norm(turned)


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
        covariance: of (centre u, centre v, semi-major, semi-minor in px; angle in rad).
        half_angle: of the cone, rad.
        apex_offset: b, mm.
        prior: of the direction; tells the mirror solution, which has the same ellipse or almost
            the same, from the true one.
    """
    points = ellipse_points(ellipse, jnp.asarray(generator_angles(FEW_POINTS)))
    met = surface.intersect(*microscope.ray(points))
    whitening = jnp.linalg.inv(jnp.linalg.cholesky(mismatch_covariance(ellipse, covariance)))

    def mismatch(tip, axis):
        beam = Beam(tip=tip, axis=axis, half_angle=half_angle, apex_offset=apex_offset)
        contour = spot_contour(beam, surface, microscope, points=FEW_POINTS)
        return whitening @ ellipse_mismatch(contour, ellipse)

    solve = partial(_refined, mismatch, surface, prior)
    return _best_and_mirror(solve, _leaning_either_way(met, half_angle, apex_offset))


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
        sigma_px: standard deviation of a point across the contour, px; the cone and the prior are
            those of `pose_from_ellipse`.
    """

    def on_wall(pixel):
        return surface.intersect(*microscope.ray(pixel)).point

    met = surface.intersect(*microscope.ray(contour))
    steps = jax.vmap(jax.jacfwd(on_wall))(contour)  # mm per px
    cos_a, sin_a = jnp.cos(half_angle), jnp.sin(half_angle)

    def off_contour(tip, axis):
        offset = met.point - (tip + apex_offset * axis)
        along = dot(offset, axis)
        across = offset - along[:, None] * axis
        radius = jnp.sqrt(dot(across, across))
        normal = across * (cos_a / radius)[:, None] - sin_a * axis
        slopes = [dot(normal, steps[..., k]) for k in range(2)]
        # The gradient's length hardly moves with the pose: a constant within a step.
        off_px = (radius * cos_a - along * sin_a) / jax.lax.stop_gradient(jnp.hypot(*slopes))
        return off_px / sigma_px

    solve = partial(_refined, off_contour, surface, prior)
    return _best_and_mirror(solve, _leaning_either_way(met, half_angle, apex_offset))
