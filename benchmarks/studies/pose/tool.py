"""A tool with one cone of light or three, and its pose from the spots of all of them at once."""

from __future__ import annotations

import math
from functools import partial
from operator import itemgetter
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float, ScalarLike
from scipy.optimize import least_squares

import optics
from scenes.world import Cone

_POINTS = 32  # of a contour whose ellipse is compared: 1e-7 px


class Tool(NamedTuple):
    """Cones fixed to one rigid shaft, evenly about its axis, all leaning outwards alike.

    What is known of the tool that others reported on is that it carries three spotlights. Here
    their tips lie on a circle, and they are lit one after the other, so that spots neither overlap
    nor are taken for each other.

    Attributes:
        cone: half-angle (rad) and b (mm), the same of all.
        cones: how many.
        circle_mm: radius of the circle on which their tips lie.
        splay: angle between each cone's axis and the tool's, rad.
    """

    cone: Cone
    cones: int
    circle_mm: float
    splay: float

    @property
    def unknowns(self) -> int:
        """Tip and axis, five; the roll about the axis shows in several spots only."""
        return 5 if self.cones == 1 else 6


def one_spot(cone: Cone) -> Tool:
    """A cone along the tool's axis."""
    return Tool(cone, 1, 0.0, 0.0)


def three_spots(cone: Cone) -> Tool:
    """Three fibres of 0.5 mm that touch each other, splayed by 10 degrees."""
    return Tool(cone, 3, 0.5 / math.sqrt(3.0), math.radians(10.0))


class ToolPose(NamedTuple):
    """Where a tool is, in the eye frame.

    Attributes:
        tip: centre of the circle of tips, mm.
        axis: unit vector towards the wall.
        roll: of the first cone from `perpendicular_frame(axis)`'s first vector, rad.
    """

    tip: Float[ArrayLike, "3"]
    axis: Float[ArrayLike, "3"]
    roll: ScalarLike


class ToolFit(NamedTuple):
    """A tool's pose from its spots.

    Attributes:
        best: the pose of least cost.
        distance: from its tip along its axis to the wall, mm.
    """

    best: ToolPose
    distance: float


def beams(tool: Tool, pose: ToolPose) -> optics.Beam:
    """The tool's cones in the eye frame, the leading axis over cones."""
    first, second = optics.perpendicular_frame(pose.axis)
    turns = pose.roll + 2.0 * np.pi * np.arange(tool.cones) / tool.cones
    outward = jnp.cos(turns)[:, None] * first + jnp.sin(turns)[:, None] * second
    half_angle, b = tool.cone
    return optics.Beam(
        tip=pose.tip + tool.circle_mm * outward,
        axis=math.cos(tool.splay) * jnp.asarray(pose.axis) + math.sin(tool.splay) * outward,
        half_angle=jnp.full(tool.cones, half_angle),
        apex_offset=jnp.full(tool.cones, b),
    )


def moved(pose: ToolPose, step: Float[ArrayLike, "6"]) -> ToolPose:
    """Tip shifted (mm), axis turned along its two perpendiculars and rolled (rad)."""
    step = jnp.asarray(step)
    first, second = optics.perpendicular_frame(pose.axis)
    turned = pose.axis + step[3] * first + step[4] * second
    return ToolPose(pose.tip + step[:3], turned / jnp.linalg.norm(turned), pose.roll + step[5])


def contours(
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

    return jax.vmap(of)(beams(tool, pose))


def normals(contour: Float[ArrayLike, "*cones points 2"]) -> Float[Array, "*cones points 2"]:
    """Unit normals of closed curves."""
    contour = jnp.asarray(contour)
    along = jnp.roll(contour, -1, axis=-2) - jnp.roll(contour, 1, axis=-2)
    across = jnp.stack([along[..., 1], -along[..., 0]], axis=-1)
    return across / jnp.linalg.norm(across, axis=-1, keepdims=True)


@partial(jax.jit, static_argnames=("tool", "axis_known"))
def bound(
    tool: Tool,
    pose: ToolPose,
    wall: optics.Sphere,
    view: optics.Microscope,
    *,
    sigma_px: ScalarLike,
    axis_known: bool = False,
) -> Float[Array, "n n"]:
    """Least covariance that any unbiased estimator can have (Cramer 1946, Rao 1945).

    Args:
        tool: whose spots are seen.
        pose: the true one.
        wall: the eyeball.
        view: the camera.
        sigma_px: noise across the contour of each of 128 points a spot, px.
        axis_known: leaves the tip and the roll.

    Returns:
        Of tip (mm) and axis along its two perpendiculars (rad); of the tip alone if `axis_known`.
    """
    across = normals(contours(tool, pose, wall, view))
    slopes = jax.jacfwd(lambda step: contours(tool, moved(pose, step), wall, view))(jnp.zeros(6))
    rows = jnp.einsum("cpi,cpij->cpj", across, slopes).reshape(-1, 6) / sigma_px
    free = [i for i in range(tool.unknowns) if not (axis_known and i in (3, 4))]
    rows = rows[:, np.array(free)]
    told = 3 if axis_known else 5
    return jnp.linalg.inv(rows.T @ rows)[:told, :told]


def mismatch_covariance(
    contour: Float[Array, "points 2"], ellipse: optics.Ellipse, sigma_px: ScalarLike
) -> Float[Array, "5 5"]:
    """Covariance of `optics.ellipse_mismatch` from noise across a contour at each of its points.

    Args:
        contour: without noise, or with: to first order it does not matter, px.
        ellipse: its own.
        sigma_px: of the noise.
    """
    across = normals(contour)

    def mismatch(shift: Float[Array, "points"]) -> Float[Array, "5"]:
        return optics.ellipse_mismatch(contour + shift[:, None] * across, ellipse)

    slopes = jax.jacrev(mismatch)(jnp.zeros(contour.shape[0]))
    return sigma_px**2 * slopes @ slopes.T


def fit(
    tool: Tool,
    ellipses: optics.Ellipse,
    covariances: Float[np.ndarray, "cones 5 5"],
    wall: optics.Sphere,
    view: optics.Microscope,
    prior: optics.DirectionPrior,
) -> ToolFit:
    """The pose whose spots have the measured ellipses, all at once.

    Args:
        tool: what is known of it.
        ellipses: of its spots in the tool's order, px; the leading axis is over the cones.
        covariances: of `optics.ellipse_mismatch`.
        wall: the eyeball.
        view: the camera.
        prior: of the axis, (3,) and rad; it also says where to start, once as it is and once
            mirrored at the wall.
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
    # Its apex on the wall, a cone has a contour of no size, which no mismatch sees: it would
    # win.
    _, best, distance = min(solutions, key=lambda found: (float(found[2]) <= 0, found[0]))
    return ToolFit(best, float(distance))


@partial(jax.jit, static_argnums=0)
def _linear(tool, step, start, ellipses, whitening, wall, view, prior):
    """Residuals over their standard deviations, and their slopes: compiled as one."""

    def residual(step):
        pose = moved(start, step)
        seen = contours(tool, pose, wall, view, points=_POINTS)
        off = jax.vmap(optics.ellipse_mismatch)(seen, ellipses)
        told = jnp.cross(pose.axis, prior.axis) / prior.sigma
        # A roll that no spot shows stays where it is.
        still = step[tool.unknowns :]
        found = jnp.concatenate([jnp.einsum("cij,cj->ci", whitening, off).ravel(), told, still])
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
    """Two poses, of the given axis and of its mirror image: from the spots' size and places."""
    met = wall.intersect(*view.ray(ellipses.centre))
    middle, outward = jnp.mean(met.point, axis=0), -jnp.mean(met.normal, axis=0)
    outward = outward / jnp.linalg.norm(outward)
    half_angle, b = tool.cone
    distance = jnp.mean(ellipses.semi_minor) * view.scale / math.tan(half_angle) + b

    def start(axis: Array) -> ToolPose:
        first, second = optics.perpendicular_frame(axis)
        aside = met.point[0] - middle
        return ToolPose(middle - distance * axis, axis, jnp.arctan2(aside @ second, aside @ first))

    return jax.vmap(start)(jnp.stack([axis, 2.0 * (outward @ axis) * outward - axis]))
