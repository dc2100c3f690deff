"""The pose of a tool with one or several cones of light, from all spots together."""

import math
from functools import partial
from operator import itemgetter
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float, ScalarLike
from scipy.optimize import least_squares

from eyespot import optics

_CONTOUR_POINTS = 32  # per contour; its ellipse is then accurate to 1e-7 px


class Tool(NamedTuple):
    """Equal cones fixed to a rigid shaft, evenly spaced around its axis and tilted outwards.

    Attributes:
        half_angle: of each cone, rad.
        apex_offset: b of each cone, mm.
        circle_mm: radius of the circle on which the tips lie, mm.
        splay: angle between each cone's axis and the tool's, rad.
    """

    half_angle: float
    apex_offset: float
    cones: int
    circle_mm: float
    splay: float

    @property
    def unknowns(self) -> int:
        """Number of parameters: tip, axis and roll; a single spot does not determine the roll."""
        return 5 if self.cones == 1 else 6


class ToolPose(NamedTuple):
    """Position and direction of a tool in the eye frame.

    Attributes:
        tip: centre of the circle of tips, mm.
        axis: unit vector towards the wall.
        roll: angle of the first cone from the first vector of `perpendicular_frame(axis)`, rad.
    """

    tip: Float[ArrayLike, "3"]
    axis: Float[ArrayLike, "3"]
    roll: ScalarLike


def tool_beams(tool: Tool, pose: ToolPose) -> optics.Beam:
    """The tool's cones in the eye frame; the leading axis is over cones."""
    first, second = optics.perpendicular_frame(pose.axis)
    turns = pose.roll + 2.0 * np.pi * np.arange(tool.cones) / tool.cones
    outward = jnp.cos(turns)[:, None] * first + jnp.sin(turns)[:, None] * second
    return optics.Beam(
        tip=pose.tip + tool.circle_mm * outward,
        axis=math.cos(tool.splay) * jnp.asarray(pose.axis) + math.sin(tool.splay) * outward,
        half_angle=jnp.full(tool.cones, tool.half_angle),
        apex_offset=jnp.full(tool.cones, tool.apex_offset),
    )


def moved(pose: ToolPose, step: Float[ArrayLike, "6"]) -> ToolPose:
    """The pose with its tip shifted (mm), its axis turned along its perpendiculars, and rolled."""
    step = jnp.asarray(step)
    first, second = optics.perpendicular_frame(pose.axis)
    turned = pose.axis + step[3] * first + step[4] * second
    return ToolPose(pose.tip + step[:3], turned / jnp.linalg.norm(turned), pose.roll + step[5])


def tool_contours(
    tool: Tool,
    pose: ToolPose,
    wall: optics.Sphere,
    view: optics.Microscope,
    *,
    points: int = 128,
) -> Float[Array, "cones points 2"]:
    """Images of the spots' edges, px."""

    def of(beam: optics.Beam) -> Float[Array, "points 2"]:
        return optics.spot_contour(beam, wall, view, points=points)

    return jax.vmap(of)(tool_beams(tool, pose))


def contour_normals(
    contour: Float[ArrayLike, "*cones points 2"],
) -> Float[Array, "*cones points 2"]:
    """Unit normals of closed curves."""
    contour = jnp.asarray(contour)
    along = jnp.roll(contour, -1, axis=-2) - jnp.roll(contour, 1, axis=-2)
    across = jnp.stack([along[..., 1], -along[..., 0]], axis=-1)
    return across / jnp.linalg.norm(across, axis=-1, keepdims=True)


@partial(jax.jit, static_argnames="tool")
def tool_pose_bound(
    tool: Tool,
    pose: ToolPose,
    wall: optics.Sphere,
    view: optics.Microscope,
    *,
    sigma_px: ScalarLike,
) -> Float[Array, "5 5"]:
    """Least covariance that any unbiased estimator can have (Cramer 1946, Rao 1945).

    Args:
        sigma_px: standard deviation across the contour of each of a spot's 128 points, px.

    Returns:
        Covariance of the tip (mm) and of the axis along its two perpendiculars (rad).
    """
    across = contour_normals(tool_contours(tool, pose, wall, view))
    slopes = jax.jacfwd(lambda step: tool_contours(tool, moved(pose, step), wall, view))(
        jnp.zeros(6)
    )
    rows = jnp.einsum("cpi,cpij->cpj", across, slopes).reshape(-1, 6) / sigma_px
    free = rows[:, : tool.unknowns]
    return jnp.linalg.inv(free.T @ free)[:5, :5]


def fit_tool(
    tool: Tool,
    ellipses: optics.Ellipse,
    covariances: Float[np.ndarray, "cones 5 5"],
    wall: optics.Sphere,
    view: optics.Microscope,
    prior: optics.DirectionPrior,
) -> tuple[ToolPose, float]:
    """Fit the pose to the measured ellipses of all spots; also the distance to the wall, mm.

    Args:
        ellipses: ellipses of the spots, px; the leading axis is over the cones.
        covariances: covariances of `optics.ellipse_mismatch`.
        prior: prior of the axis; the solver starts with it and with its mirror image at the wall.
    """
    whitening = np.linalg.inv(np.linalg.cholesky(np.asarray(covariances)))
    starts = _starts(tool, ellipses, wall, view, prior.axis)
    solutions = []
    for start in (jax.tree.map(itemgetter(i), starts) for i in range(2)):
        given = start, ellipses, whitening, wall, view, prior
        found = least_squares(
            lambda step, given=given: np.asarray(_linear(tool, step, *given)[0]),
            np.zeros(6),
            jac=lambda step, given=given: np.asarray(_linear(tool, step, *given)[1]),
            x_scale="jac",
            xtol=1e-10,
            ftol=1e-10,
            gtol=1e-10,
        )
        solutions.append((found.cost, *_ended(start, found.x, wall)))
    # A cone whose apex lies on the wall has a contour of size 0, for which every mismatch is 0.
    # Such a solution is behind the wall and ranks last.
    _, best, distance = min(solutions, key=lambda found: (float(found[2]) <= 0, found[0]))
    return best, float(distance)


@partial(jax.jit, static_argnums=0)
def _linear(tool, step, start, ellipses, whitening, wall, view, prior):
    """Residuals over their standard deviations, and their derivatives."""

    def residual(step):
        pose = moved(start, step)
        seen = tool_contours(tool, pose, wall, view, points=_CONTOUR_POINTS)
        off = jax.vmap(optics.ellipse_mismatch)(seen, ellipses)
        of_prior = jnp.cross(pose.axis, prior.axis) / prior.sigma
        # A single spot does not determine the roll, which keeps its start value.
        still = step[tool.unknowns :]
        found = jnp.concatenate([jnp.einsum("cij,cj->ci", whitening, off).ravel(), of_prior, still])
        return found, found

    slopes, found = jax.jacfwd(residual, has_aux=True)(step)
    return found, slopes


@jax.jit
def _ended(
    start: ToolPose, step: Float[ArrayLike, "6"], wall: optics.Sphere
) -> tuple[ToolPose, Array]:
    pose = moved(start, step)
    return pose, wall.intersect(jnp.asarray(pose.tip), jnp.asarray(pose.axis)).distance


@partial(jax.jit, static_argnums=0)
def _starts(
    tool: Tool,
    ellipses: optics.Ellipse,
    wall: optics.Sphere,
    view: optics.Microscope,
    axis: Float[Array, "3"],
) -> ToolPose:
    """Start poses with the axis and with its mirror image, from the spots' sizes and positions."""
    met = wall.intersect(*view.ray(ellipses.centre))
    middle, outward = jnp.mean(met.point, axis=0), -jnp.mean(met.normal, axis=0)
    outward = outward / jnp.linalg.norm(outward)
    reach = jnp.mean(ellipses.semi_minor) * view.scale / math.tan(tool.half_angle)
    distance = reach + tool.apex_offset

    def start(axis: Array) -> ToolPose:
        first, second = optics.perpendicular_frame(axis)
        aside = met.point[0] - middle
        return ToolPose(middle - distance * axis, axis, jnp.arctan2(aside @ second, aside @ first))

    return jax.vmap(start)(jnp.stack([axis, 2.0 * (outward @ axis) * outward - axis]))
