"""The rendered part: frames of an even wall, spots by the estimator, poses by its exact model."""

from __future__ import annotations

import csv
import math
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

import optics
import scenes
from benchmarks.evaluation import true_calibration
from benchmarks.reporting import Study
from benchmarks.studies.pose.analytic import (
    HELD_RAD,
    NO_WEIGHT_RAD,
    Place,
    axis_bound_deg,
    place_at,
    tip_bound,
)
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
from benchmarks.studies.pose.tool import Tool, ToolPose, beams, bound, fit, one_spot, three_spots
from estimator import (
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
from scenes import Scene
from scenes.world import World

STILL = {
    "phantom.wall": "uniform",
    "instrument.visible": False,
    "exposures.kinds": ["metered"],
    "microscope.width_px": 800,  # three spots are wider apart than one is wide
    "microscope.height_px": 720,
    "clocks.camera_hz": 1.0,
}
"""A frame a second, in which the tool stands still."""

_REST_S = 0.45  # before and after the middle of an exposure
_INCIDENCES_DEG = (10.0, 20.0, 30.0)
_FAR_MM = 4.0  # farther, splayed spots leave the window
_GOLDEN_DEG = 180.0 * (3.0 - math.sqrt(5.0))  # turns that repeat nothing
_POINTS = 128


def places_at(scene: Scene, *, c: float, poses: int) -> list[Place]:
    """Poses with their axis through one point of the wall, at several distances and incidences."""
    surface = World(scene).wall
    assert isinstance(surface, optics.Sphere)  # the study's check
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


def measure(study: Study, *, eccentricities: list[float], poses: int) -> list[PoseError]:
    """Render, track and solve with one spot and with three.

    Args:
        study: whose scene is rendered.
        eccentricities: c of the wall points, mm.
        poses: at each of them.
    """
    given = World(study.scene).cone
    tools = (one_spot(given), three_spots(given))
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
    stacks = study.stacks(trials)
    spots = study.folder / "spots"
    spots.mkdir(exist_ok=True)
    rng = np.random.default_rng([study.seed, 2])
    rows = []
    for name, stack in stacks.items():
        results = iter(_spots(stack, spots / f"{name}.csv"))
        microscope = read_microscope(stack.folder / "microscope.json")
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
    """Spots of single frames: from one to the next they jump farther than a tracker believes."""
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
    """A beam a second, at rest while the camera exposes."""
    file.parent.mkdir(exist_ok=True)
    lit = [
        pose
        for place in every
        for tool in tools
        for pose in np.hstack([*map(np.asarray, _tips_and_axes(tool, place.pose))]).tolist()
    ]
    with file.open("w", newline="", encoding="utf-8") as output:
        writer = csv.writer(output)
        writer.writerow("time_s x_mm y_mm z_mm axis_x axis_y axis_z".split())
        for i, pose in enumerate(lit):
            # The first frame is due at the first row, the last at the last.
            for time in (i - _REST_S * (i > 0), i + _REST_S * (i < len(lit) - 1)):
                writer.writerow([time, *pose])


def _errors(
    tool: Tool, place: Place, seen: list[Spot], prior: np.ndarray, ranger: Ranger
) -> list[PoseError]:
    """With the prior, without, and with the axis known, all from the same spots."""
    microscope = ranger.microscope
    surface, view = optics.Sphere(microscope.eye_radius_mm), microscope.ideal_microscope()
    # Noise of each of 128 points that a circle's semi-axis of this error has (DESIGN §7).
    sigma = float(np.mean([spot.sigma_semi_minor_px for spot in seen])) * math.sqrt(_POINTS / 3)
    true = np.asarray(place.pose.axis)
    rows = []
    for name, axis, weight in (
        (PRIOR, prior, math.radians(PRIOR_DEG)),
        (FREE, prior, NO_WEIGHT_RAD),
        (KNOWN, true, HELD_RAD),
    ):
        # With an axis held tight the ranger may end with the cone's apex on the wall; see `fit`.
        if tool.cones == 1 and name != KNOWN:
            found = ranger.distance(seen[0], axis=axis, axis_sigma_rad=weight)
            tip, towards = found.poses[0].tip_mm, found.poses[0].axis
            distance, own = found.distance_mm, found.sigma_mm
        else:
            ellipses = _ellipses(seen)
            spread = jnp.stack([jnp.asarray(spot.covariance) for spot in seen])
            covariances = np.asarray(_mismatch_covariances(ellipses, spread))
            led = optics.DirectionPrior(jnp.asarray(axis), weight)
            together = fit(tool, ellipses, covariances, surface, view, led)
            tip, towards = np.asarray(together.best.tip), np.asarray(together.best.axis)
            distance, own = together.distance, math.nan
        covariance = np.asarray(
            bound(tool, place.pose, surface, view, sigma_px=sigma, axis_known=name == KNOWN)
        )
        if name == KNOWN:
            # A shift of the tip along the wall leaves the distance as it is, to first order.
            per_mm = place.outward / float(place.outward @ true)
            own = math.sqrt(per_mm @ covariance @ per_mm)
        rows.append(
            PoseError(
                source="rendered",
                spots=tool.cones,
                prior=name,
                z_f_mm=microscope.pinhole_height_mm,
                c_mm=place.c_mm,
                d_mm=place.d_mm,
                incidence_deg=place.incidence_deg,
                azimuth_deg=place.azimuth_deg,
                noise_px=sigma,
                mirrored=is_mirrored(towards, true, place.outward),
                tip_error_mm=float(np.linalg.norm(tip - np.asarray(place.pose.tip))),
                axis_error_deg=angle_deg(towards, true),
                distance_error_mm=distance - place.d_mm,
                tip_bound_mm=tip_bound(covariance),
                axis_bound_deg=axis_bound_deg(covariance),
                sigma_distance_mm=own,
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
    lit = beams(tool, pose)
    return lit.tip, lit.axis


_mismatch_covariances = jax.jit(jax.vmap(optics.mismatch_covariance))
