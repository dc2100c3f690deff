"""Makes a plan from a scene, stated uncertainties of its keys, and a rehearsal."""

from __future__ import annotations

import json
import math
import tempfile
from collections.abc import Callable, Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.predictions.observing import observed, pose_path
from benchmarks.predictions.plan import ELLIPSE, QUANTITIES, Plan
from estimator import Ranger, Spot, read_calibration, read_microscope
from estimator.files import read_poses
from optics import InputError
from scenes import Scene, World, changed, render_stack, scene_toml
from scenes.world import kinematics

_LEAST_ROBOT_MM = 1e-5  # what a file rounds poses to


def predicted(
    scene: Scene,
    uncertain: Mapping[str, float],
    *,
    calibration: Path | None = None,
    model: str | None = None,
    exposure: str | None = None,
    progress: Callable[[], None] = lambda: None,
) -> Plan:
    """The plan of an experiment.

    What is expected is the exact geometry of the scene. How far a stated key moves it is the
    difference between two scenes, one standard uncertainty to either side. The noise, and in which
    frames there is a spot at all, are those of a rehearsal: the scene is rendered and measured.

    Args:
        uncertain: keys of the scene and their standard uncertainties, {"phantom.radius_mm": 0.2}.
        calibration: file, for the distances; None for none.
        model: of the distances; by default the calibration's.
        exposure: kind of the images; by default metered, if the scene has it.
        progress: is called after each frame of the rehearsal.

    Raises:
        InputError: a key is unknown or no number, or a scene beside the planned one is impossible.
    """
    kinds = scene.exposures.kinds
    kind = exposure or ("metered" if "metered" in kinds else kinds[0])
    if kind not in kinds:
        known = ", ".join(kinds)
        raise InputError(f"exposure = {kind!r} is none of the scene's: {known}.")
    for key, sigma in uncertain.items():
        _check(scene, key, sigma)
    with tempfile.TemporaryDirectory() as made:
        folder = Path(made) / "rehearsal"
        render_stack(scene, folder, progress=progress)
        microscope_file = folder / "microscope.json"
        microscope = json.loads(microscope_file.read_text())
        view = read_microscope(microscope_file)
        ranger = Ranger(read_calibration(calibration), view, model=model) if calibration else None
        poses = read_poses(folder / "kinematics.csv")
        rehearsed = observed(folder, exposure=kind, poses=poses, ranger=None)
    world = World(scene)
    times = np.asarray(world.times)
    expected = _exact(world, times, ranger)
    noise = _noise(world, times, expected, rehearsed.noise, ranger)
    beside = [
        [
            _exact(World(changed(scene, {key: _value(scene, key) + side})), times, ranger)
            for side in (-sigma, sigma)
        ]
        for key, sigma in uncertain.items()
    ]
    shape = (len(uncertain), *expected.shape)
    moved = np.array([(up - down) / 2 for down, up in beside]).reshape(shape)
    bent = np.array([(up + down) / 2 - expected for down, up in beside]).reshape(shape)
    # What is not proportional to an error, as where a motion begins, counts as noise.
    noise = np.sqrt(noise**2 + np.sum(bent**2, axis=0))
    # Where the rehearsal has no spot, none is predicted.
    expected = np.where(np.isnan(noise), np.nan, expected)
    return Plan(
        scene=scene_toml(scene),
        software=f"eyespot {version('eyespot')}",
        exposure=kind,
        calibration=json.loads(calibration.read_text()) if calibration else None,
        model=ranger.model if ranger else None,
        microscope=microscope,
        uncertain={key: (_value(scene, key), sigma) for key, sigma in uncertain.items()},
        times_s=times,
        expected=expected,
        noise=noise,
        moved=np.where(np.isnan(noise), np.nan, moved),
    )


def _exact(world: World, times: np.ndarray, ranger: Ranger | None) -> np.ndarray:
    """The quantities by geometry, (n, 6)."""
    spread = world.spread_spots
    ellipse = (world.truth if spread is None else spread).half_max
    # The window of a scene follows its spot; a microscope's does not.
    centre = np.asarray(ellipse.centre) - np.asarray(world.microscope.principal_point)
    axes = np.stack([ellipse.semi_major, ellipse.semi_minor], axis=1)
    distance = np.full(len(times), np.nan)
    if ranger is not None:
        spots = (
            _spot(np.array([*place, *size, angle]), ranger)
            for place, size, angle in zip(centre, axes, np.asarray(ellipse.angle), strict=True)
        )
        beams = np.asarray(world.truth.beam.axis)
        distance = np.array(
            [
                ranger.distance(spot, axis=beam).distance_mm
                for spot, beam in zip(spots, beams, strict=True)
            ]
        )
    path = pose_path(_poses_of(world))
    travelled = np.interp(times, *path)
    return np.column_stack([centre, axes, distance, travelled])


def _poses_of(world: World) -> np.ndarray:
    """Stamps and positions that the robot reports, without the jitter of its clock, (m, 4)."""
    still = changed(world.scene, {"clocks.kinematics_jitter_s": 0.0})
    return kinematics(still, world.motion)[:, :4]


def _spot(ellipse: np.ndarray, ranger: Ranger) -> Spot:
    """An ellipse as it would be measured, with the centre from the principal point."""
    x, y = (ellipse[:2] + ranger.microscope.principal_point_px).tolist()
    major, minor, angle = ellipse[2:].tolist()
    return Spot(
        x_px=x,
        y_px=y,
        semi_major_px=major,
        semi_minor_px=minor,
        angle_rad=angle,
        covariance=np.eye(5),
        edge_width_px=1.0,
        coverage=1.0,
        inlier_fraction=1.0,
        saturated=0.0,
    )


def _noise(
    world: World,
    times: np.ndarray,
    expected: np.ndarray,
    rehearsed: np.ndarray,
    ranger: Ranger | None,
) -> np.ndarray:
    """Standard deviations of the measurement, (n, 6); NaN without a spot."""
    noise = np.full(expected.shape, np.nan)
    noise[:, :ELLIPSE] = rehearsed[:, :ELLIPSE]
    if ranger is not None:
        # From the spot's size to the distance: as of the cone, d + |b| over the semi-minor axis.
        minor = expected[:, QUANTITIES.index("semi_minor_px")]
        per_px = np.abs(expected[:, ELLIPSE] - ranger.calibration.values["b"]) / minor
        noise[:, ELLIPSE] = per_px * rehearsed[:, QUANTITIES.index("semi_minor_px")]
    clocks = world.scene.clocks
    jitter = math.hypot(clocks.kinematics_jitter_s, clocks.camera_jitter_s)
    noise[:, -1] = np.hypot(np.asarray(world.speed) * jitter, _LEAST_ROBOT_MM)
    return noise


def _check(scene: Scene, key: str, sigma: float) -> None:
    if not 0 < sigma < math.inf:
        raise InputError(f"the uncertainty of {key} must be positive and finite; got {sigma}.")
    value = _value(scene, key)
    if isinstance(value, bool) or not isinstance(value, float | int) or not math.isfinite(value):
        raise InputError(
            f"{key} is {value!r}, not a number with an uncertainty. Name a key of the scene such as"
            " phantom.radius_mm."
        )


def _value(scene: Scene, key: str) -> Any:
    """The value of a key of the scene."""
    found: Any = scene.model_dump(mode="json", by_alias=True)
    for part in key.split("."):
        if not isinstance(found, dict) or part not in found:
            # The scene says which keys are near.
            changed(scene, {key: 0.0})
            raise InputError(f"{key} is not a key of this scene. `eyespot scene init` lists them.")
        found = found[part]
    return found
