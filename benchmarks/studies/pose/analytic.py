"""The analytic part: exact contours with noise, over the working volume."""

from __future__ import annotations

import math
from functools import partial
from operator import itemgetter
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from scipy.stats import qmc

import optics
from benchmarks.studies.pose.errors import (
    FREE,
    KNOWN,
    PRIOR,
    PRIOR_DEG,
    PoseError,
    angle_deg,
    drawn_prior,
    is_mirrored,
)
from benchmarks.studies.pose.tool import (
    Tool,
    ToolPose,
    bound,
    contours,
    fit,
    mismatch_covariance,
    normals,
)

HALF_WIDTH_MM = 5.0
"""Of the square about the microscope's axis in which O lies: 10 mm x 10 mm."""
NEAREST_MM, FARTHEST_MM = 0.5, 5.5
"""Tip to wall along the beam: 5 mm of depth."""
INCIDENCE_DEG = (10.0, 30.0)
NOISE_PX = 0.05
"""Across the contour, of each of 128 points."""

NO_WEIGHT_RAD = 1e6
"""Of an axis that says nothing."""

HELD_RAD = 1e-6
"""Of an axis that is known."""


class Place(NamedTuple):
    """A pose of the working volume.

    Attributes:
        pose: of the tool.
        c_mm, d_mm, incidence_deg, azimuth_deg: where that is.
        outward: wall's normal at O.
    """

    pose: ToolPose
    c_mm: float
    d_mm: float
    incidence_deg: float
    azimuth_deg: float
    outward: np.ndarray


def places(wall: optics.Sphere, *, count: int, seed: int) -> list[Place]:
    """Poses that fill the working volume evenly (scrambled Sobol points).

    Args:
        wall: the eyeball.
        count: of poses; a power of two is balanced.
        seed: of the scrambling.
    """
    engine = qmc.Sobol(d=6, scramble=True, rng=np.random.default_rng(seed))
    low = [-HALF_WIDTH_MM, -HALF_WIDTH_MM, NEAREST_MM, INCIDENCE_DEG[0], 0.0, 0.0]
    high = [HALF_WIDTH_MM, HALF_WIDTH_MM, FARTHEST_MM, INCIDENCE_DEG[1], 360.0, 360.0]
    return [
        place_at(
            wall,
            c=math.hypot(x, y),
            around_deg=math.degrees(math.atan2(y, x)),
            d=d,
            incidence_deg=incidence,
            azimuth_deg=azimuth,
            roll=math.radians(roll),
        )
        for x, y, d, incidence, azimuth, roll in qmc.scale(engine.random(count), low, high)
    ]


def place_at(
    wall: optics.Sphere,
    *,
    c: float,
    around_deg: float,
    d: float,
    incidence_deg: float,
    azimuth_deg: float,
    roll: float = 0.0,
) -> Place:
    """The pose by where its axis meets the wall; arguments as of `optics.beam_at_spot`."""
    beam = optics.beam_at_spot(
        wall,
        eccentricity=c,
        azimuth=math.radians(around_deg),
        distance=d,
        incidence=math.radians(incidence_deg),
        incidence_azimuth=math.radians(azimuth_deg),
        half_angle=0.0,
        apex_offset=0.0,
    )
    tip, axis = np.asarray(beam.tip), np.asarray(beam.axis)
    outward = (tip + d * axis) / float(wall.radius)
    return Place(ToolPose(tip, axis, roll), c, d, incidence_deg, azimuth_deg, outward)


def errors(
    tool: Tool,
    every: list[Place],
    wall: optics.Sphere,
    view: optics.Microscope,
    *,
    seed: int,
) -> list[PoseError]:
    """A noisy contour at each place, its pose with a drawn prior, without one, with a known axis.

    One spot is solved by `optics.pose_from_contour`, several by `pose_tool.fit` from the ellipses
    of the same noisy contours.
    """
    rng = np.random.default_rng([seed, tool.cones])
    poses = ToolPose(*map(np.array, zip(*(place.pose for place in every), strict=True)))
    clean, bounds, known = map(np.asarray, _contours_and_bounds(tool, poses, wall, view))
    noise = NOISE_PX * rng.standard_normal(clean.shape[:-1])
    noisy = clean + noise[..., None] * np.asarray(normals(clean))
    priors = np.stack([drawn_prior(np.asarray(place.pose.axis), rng) for place in every])
    rows = []
    truth = np.stack([np.asarray(place.pose.axis) for place in every])
    for name, axes, sigma in (
        (PRIOR, priors, math.radians(PRIOR_DEG)),
        (FREE, priors, NO_WEIGHT_RAD),
        (KNOWN, truth, HELD_RAD),
    ):
        tips, found, distances, sigmas = _solved(tool, noisy, axes, sigma, wall, view)
        for i, place in enumerate(every):
            covariance = known[i] if name == KNOWN else bounds[i]
            rows.append(
                PoseError(
                    source="analytic",
                    spots=tool.cones,
                    prior=name,
                    z_f_mm=float(view.pinhole_height),
                    c_mm=place.c_mm,
                    d_mm=place.d_mm,
                    incidence_deg=place.incidence_deg,
                    azimuth_deg=place.azimuth_deg,
                    noise_px=NOISE_PX,
                    mirrored=is_mirrored(found[i], truth[i], place.outward),
                    tip_error_mm=float(np.linalg.norm(tips[i] - np.asarray(place.pose.tip))),
                    axis_error_deg=angle_deg(found[i], truth[i]),
                    distance_error_mm=float(distances[i] - place.d_mm),
                    tip_bound_mm=tip_bound(covariance),
                    axis_bound_deg=axis_bound_deg(covariance),
                    sigma_distance_mm=float(sigmas[i]),
                )
            )
    return rows


def tip_bound(covariance: np.ndarray) -> float:
    """Standard deviation of the tip in three dimensions, mm."""
    return float(np.sqrt(np.trace(covariance[:3, :3])))


def axis_bound_deg(covariance: np.ndarray) -> float:
    """Standard deviation of the axis, both ways together; 0 where it is known."""
    return math.degrees(np.sqrt(np.trace(covariance[3:, 3:])))


def _solved(
    tool: Tool,
    noisy: np.ndarray,
    axes: np.ndarray,
    sigma: float,
    wall: optics.Sphere,
    view: optics.Microscope,
) -> tuple[np.ndarray, ...]:
    """Tips, axes, distances, and the distances' standard errors (NaN of several spots)."""
    if tool.cones == 1:
        best = _one_by_contour(noisy[:, 0], axes, np.asarray(sigma), wall, view, *tool.cone)
        return tuple(map(np.asarray, (best.tip, best.axis, best.distance, best.distance_error)))
    ellipses, covariances = _ellipses(noisy)
    fits = [
        fit(
            tool,
            jax.tree.map(itemgetter(i), ellipses),
            covariances[i],
            wall,
            view,
            optics.DirectionPrior(jnp.asarray(axes[i]), sigma),
        )
        for i in range(len(noisy))
    ]
    return (
        np.stack([np.asarray(found.best.tip) for found in fits]),
        np.stack([np.asarray(found.best.axis) for found in fits]),
        np.array([found.distance for found in fits]),
        np.full(len(fits), math.nan),
    )


@partial(jax.jit, static_argnums=0)
def _contours_and_bounds(
    tool: Tool, poses: ToolPose, wall: optics.Sphere, view: optics.Microscope
) -> tuple[Any, Any, Any]:
    def of(pose: ToolPose) -> tuple[Any, Any, Any]:
        given = tool, pose, wall, view
        return (
            contours(*given),
            bound(*given, sigma_px=NOISE_PX),
            bound(*given, sigma_px=NOISE_PX, axis_known=True),
        )

    return jax.vmap(of)(poses)


@jax.jit
def _one_by_contour(
    noisy: Any, axes: Any, sigma: Any, wall: Any, view: Any, half_angle: Any, b: Any
) -> optics.Pose:
    def one(contour: Any, axis: Any) -> optics.Pose:
        return optics.pose_from_contour(
            contour,
            wall,
            view,
            half_angle=half_angle,
            apex_offset=b,
            sigma_px=NOISE_PX,
            prior=optics.DirectionPrior(axis, sigma),
        ).best

    return jax.vmap(one)(noisy, axes)


@jax.jit
def _ellipses(noisy: Any) -> tuple[optics.Ellipse, Any]:
    ellipses = optics.ellipse_of_contour(noisy)
    of = jax.vmap(jax.vmap(lambda c, e: mismatch_covariance(c, e, NOISE_PX)))
    return ellipses, of(noisy, ellipses)
