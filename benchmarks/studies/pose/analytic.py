"""The analytic part: exact contours with noise, over the working volume."""

from __future__ import annotations

import math
from functools import partial
from operator import itemgetter
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from scipy.stats import qmc

import optics
from benchmarks.studies.pose.errors import (
    FARTHEST_MM,
    HALF_WIDTH_MM,
    INCIDENCE_DEG,
    NEAREST_MM,
    NOISE_PX,
    Estimate,
    Place,
    Prior,
    drawn_prior,
    place_at,
    pose_error,
)
from calibration.spots import (
    Tool,
    ToolPose,
    contour_mismatch_covariance,
    contour_normals,
    fit_tool,
    tool_contours,
    tool_pose_bound,
)


def places(wall: optics.Sphere, *, count: int, seed: int) -> list[Place]:
    """Poses that fill the working volume evenly (scrambled Sobol points).

    Args:
        count: of poses; a power of two is balanced.
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


def errors(
    tool: Tool, every: list[Place], wall: optics.Sphere, view: optics.Microscope, *, seed: int
) -> list[dict[str, Any]]:
    """Errors of the poses from a noisy contour at each place, with each kind of prior.

    One spot is solved by `optics.pose_from_contour`, several by `calibration.spots.fit_tool` from
    the ellipses of the same noisy contours.
    """
    rng = np.random.default_rng([seed, tool.cones])
    poses = ToolPose(*map(np.array, zip(*(place.pose for place in every), strict=True)))
    clean, bounds, known = map(np.asarray, _contours_and_bounds(tool, poses, wall, view))
    noise = NOISE_PX * rng.standard_normal(clean.shape[:-1])
    noisy = clean + noise[..., None] * np.asarray(contour_normals(clean))
    drawn = np.stack([drawn_prior(np.asarray(place.pose.axis), rng) for place in every])
    truth = np.stack([np.asarray(place.pose.axis) for place in every])
    return [
        pose_error(
            place,
            found,
            source="analytic",
            spots=tool.cones,
            prior=prior,
            pinhole_height=float(view.pinhole_height),
            noise_px=NOISE_PX,
            covariance=covariance,
        )
        for prior, axes, covariances in (
            (Prior.ROUGH, drawn, bounds),
            (Prior.NONE, drawn, bounds),
            (Prior.KNOWN, truth, known),
        )
        for place, found, covariance in zip(
            every, _solved(tool, noisy, axes, prior.sigma_rad, wall, view), covariances, strict=True
        )
    ]


def _solved(
    tool: Tool,
    noisy: np.ndarray,
    axes: np.ndarray,
    sigma: float,
    wall: optics.Sphere,
    view: optics.Microscope,
) -> list[Estimate]:
    """Estimates at all places; the distance's sigma is NaN for several spots."""
    if tool.cones == 1:
        best = _one_by_contour(
            noisy[:, 0], axes, np.asarray(sigma), wall, view, tool.half_angle, tool.apex_offset
        )
        columns = (best.tip, best.axis, best.distance, best.distance_error)
        return [Estimate(*row) for row in zip(*map(np.asarray, columns), strict=True)]
    ellipses, covariances = _ellipses(noisy)
    fits = [
        fit_tool(
            tool,
            jax.tree.map(itemgetter(i), ellipses),
            covariances[i],
            wall,
            view,
            optics.DirectionPrior(jnp.asarray(axes[i]), sigma),
        )
        for i in range(len(noisy))
    ]
    return [
        Estimate(np.asarray(f.best.tip), np.asarray(f.best.axis), f.distance, math.nan)
        for f in fits
    ]


@partial(jax.jit, static_argnums=0)
def _contours_and_bounds(
    tool: Tool, poses: ToolPose, wall: optics.Sphere, view: optics.Microscope
) -> tuple[Any, Any, Any]:
    def of(pose: ToolPose) -> tuple[Any, Any, Any]:
        given = tool, pose, wall, view
        return (
            tool_contours(*given),
            tool_pose_bound(*given, sigma_px=NOISE_PX),
            tool_pose_bound(*given, sigma_px=NOISE_PX, axis_known=True),
        )

    return jax.vmap(of)(poses)


@jax.jit
def _one_by_contour(
    noisy: Any, axes: Any, sigma: Any, wall: Any, view: Any, half_angle: Any, b: Any
) -> optics.BeamPose:
    def one(contour: Any, axis: Any) -> optics.BeamPose:
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
    of = jax.vmap(jax.vmap(lambda c, e: contour_mismatch_covariance(c, e, NOISE_PX)))
    return ellipses, of(noisy, ellipses)
