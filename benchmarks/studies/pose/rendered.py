"""The rendered part: frames of an even wall, spots by the estimator, poses by its exact model."""

from __future__ import annotations

import csv
import math
from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import optics
import scenes
from benchmarks.reporting import Study
from benchmarks.studies.pose.errors import (
    Estimate,
    Place,
    Prior,
    drawn_prior,
    one_spot,
    place_at,
    pose_error,
    three_spots,
)
from calibration.spots import Tool, ToolPose, fit_tool, tool_beams, tool_pose_bound
from estimator import (
    MicroscopeFile,
    NoSpot,
    Ranger,
    Spot,
    SpotRecord,
    Stack,
    SubpixelSettings,
    TrackState,
    read_microscope,
    write_spots,
)
from estimator import measure as measured
from estimator.files import written_whole
from scenes import Scene
from scenes.world import World, true_calibration

STILL = {
    "phantom.wall": "uniform",
    "instrument.visible": False,
    "exposures.kinds": ["metered"],
    "microscope.width_px": 800,  # three spots need more room than one
    "microscope.height_px": 720,
    "clocks.camera_hz": 1.0,
}
"""A frame a second, in which the tool stands still."""

_REST_S = 0.45  # time at rest before and after the middle of an exposure
_INCIDENCES_DEG = (10.0, 20.0, 30.0)
_FAR_MM = 4.0  # farther, splayed spots leave the window
_GOLDEN_DEG = 180.0 * (3.0 - math.sqrt(5.0))  # the golden angle: azimuths never repeat
_POINTS = 128


def places_at(scene: Scene, *, c: float, poses: int) -> list[Place]:
    """Poses with their axis through one point of the wall, at several distances and incidences."""
    surface = World(scene).wall
    assert isinstance(surface, optics.Sphere)  # by the study's check
    return [
        place_at(
            surface,
            c=c,
            around_deg=scene.spot.azimuth_deg,
            d=1.0 + (_FAR_MM - 1.0) * (i + 0.5) / poses,
            incidence_deg=_INCIDENCES_DEG[i % len(_INCIDENCES_DEG)],
            azimuth_deg=(i * _GOLDEN_DEG) % 360.0,
            roll=i * math.radians(_GOLDEN_DEG),
        )
        for i in range(poses)
    ]


def measure(study: Study, *, eccentricities: list[float], poses: int) -> list[dict[str, Any]]:
    """Render, track and solve with one spot and with three.

    Args:
        eccentricities: c of the wall points, mm.
        poses: at each of them.
    """
    given = World(study.scene).cone
    tools = (one_spot(*given), three_spots(*given))
    trials, every = {}, {}
    for c in eccentricities:
        name = f"c-{c:g}"
        every[name] = places_at(study.scene, c=c, poses=poses)
        file = study.folder / "poses" / f"{name}.csv"
        write_poses(file, tools, every[name])
        trials[name] = scenes.changed(
            study.scene,
            STILL | {"spot.eccentricity_mm": c, "motion": {"kind": "recorded", "file": str(file)}},
        )
    spots = study.folder / "spots"
    spots.mkdir(exist_ok=True)

    def track(name: str, stack: Stack) -> tuple[MicroscopeFile, list[Spot | NoSpot]]:
        microscope = read_microscope(stack.folder / "microscope.json")
        return microscope, _spots(stack, spots / f"{name}.csv")

    rng = np.random.default_rng([study.seed, 2])
    rows = []
    for name, (microscope, measured_spots) in study.measured(trials, track).items():
        results = iter(measured_spots)
        ranger = Ranger(true_calibration(trials[name]), microscope)
        for place in every[name]:
            of_tool = {tool: [next(results) for _ in range(tool.cones)] for tool in tools}
            prior = drawn_prior(np.asarray(place.pose.axis), rng)
            for tool, seen in of_tool.items():
                found = [result for result in seen if isinstance(result, Spot)]
                if len(found) == tool.cones:
                    rows += _errors(tool, place, found, prior, ranger)
    return rows


def _spots(stack: Stack, file: Path) -> list[Spot | NoSpot]:
    """Spots of single frames, since a tracker rejects the jumps from one frame to the next."""
    results = [
        measured(stack.image(label), TrackState(), SubpixelSettings())[0] for label in stack.labels
    ]
    write_spots(
        file,
        [
            SpotRecord(
                frame=label.frame,
                file_name=label.file_name,
                time_s=label.time_s,
                mode="subpixel",
                result=result,
            )
            for label, result in zip(stack.labels, results, strict=True)
        ],
    )
    return results


def write_poses(file: Path, tools: tuple[Tool, ...], every: list[Place]) -> None:
    """Write one beam a second, at rest while the camera exposes."""
    file.parent.mkdir(exist_ok=True)
    lit = [
        pose
        for place in every
        for tool in tools
        for pose in np.hstack([*map(np.asarray, _tips_and_axes(tool, place.pose))]).tolist()
    ]
    with (
        written_whole(file, replace=True) as partial,
        partial.open("w", newline="", encoding="utf-8") as output,
    ):
        writer = csv.writer(output)
        writer.writerow("time_s x_mm y_mm z_mm axis_x axis_y axis_z".split())
        for i, pose in enumerate(lit):
            # The first frame is due at the first row, the last at the last.
            for time in (i - _REST_S * (i > 0), i + _REST_S * (i < len(lit) - 1)):
                writer.writerow([time, *pose])


def _errors(
    tool: Tool, place: Place, seen: list[Spot], prior: np.ndarray, ranger: Ranger
) -> list[dict[str, Any]]:
    """Errors with each kind of prior, all from the same spots."""
    microscope = ranger.microscope
    surface, view = optics.Sphere(microscope.eye_radius_mm), microscope.pinhole()
    # The noise of each of n = 128 points that gives a circle's semi-axis this standard error. The
    # semi-axis is the sum of two independent terms of the radius, of 1 and of cos 2t, whose
    # variances are 1/n and 2/n of the noise's.
    sigma = float(np.mean([spot.sigma_semi_minor_px for spot in seen])) * math.sqrt(_POINTS / 3)
    true = np.asarray(place.pose.axis)
    rows = []
    for kind in Prior:
        known = kind == Prior.KNOWN
        axis = true if known else prior
        covariance = np.asarray(
            tool_pose_bound(tool, place.pose, surface, view, sigma_px=sigma, axis_known=known)
        )
        # With a fixed axis the ranger may end with the cone's apex on the wall; see `fit_tool`.
        if tool.cones == 1 and not known:
            alone = ranger.distance(seen[0], axis=axis, axis_sigma_rad=kind.sigma_rad)
            pose = alone.poses[0]
            found = Estimate(pose.tip_mm, pose.axis, alone.distance_mm, alone.sigma_mm)
        else:
            ellipses = _ellipses(seen)
            spread = jnp.stack([jnp.asarray(spot.covariance) for spot in seen])
            covariances = np.asarray(_mismatch_covariances(ellipses, spread))
            led = optics.DirectionPrior(jnp.asarray(axis), kind.sigma_rad)
            fit = fit_tool(tool, ellipses, covariances, surface, view, led)
            # A shift of the tip along the wall does not change the distance, to first order.
            per_mm = place.outward / float(place.outward @ true)
            sigma_distance = math.sqrt(per_mm @ covariance @ per_mm) if known else math.nan
            tip, towards = np.asarray(fit.best.tip), np.asarray(fit.best.axis)
            found = Estimate(tip, towards, fit.distance, sigma_distance)
        rows.append(
            pose_error(
                place,
                found,
                source="rendered",
                spots=tool.cones,
                prior=kind,
                pinhole_height=microscope.pinhole_height_mm,
                noise_px=sigma,
                covariance=covariance,
            )
        )
    return rows


def _ellipses(spots: list[Spot]) -> optics.Ellipse:
    return optics.Ellipse(
        centre=jnp.array([[spot.x_px, spot.y_px] for spot in spots]),
        semi_major=jnp.array([spot.semi_major_px for spot in spots]),
        semi_minor=jnp.array([spot.semi_minor_px for spot in spots]),
        angle=jnp.array([spot.angle_rad for spot in spots]),
    )


@partial(jax.jit, static_argnums=0)
def _tips_and_axes(tool: Tool, pose: ToolPose) -> tuple[jax.Array, jax.Array]:
    lit = tool_beams(tool, pose)
    return lit.tip, lit.axis


_mismatch_covariances = jax.jit(jax.vmap(optics.mismatch_covariance))
