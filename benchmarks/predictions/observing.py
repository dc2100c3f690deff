"""What a recording says about the quantities of a plan."""

from __future__ import annotations

import json
import math
import tempfile
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks.predictions.plan import ELLIPSE, QUANTITIES, Plan
from estimator import (
    Ranger,
    Reading,
    Spot,
    open_source,
    read_calibration,
    read_microscope,
    read_poses,
    track_source,
)
from estimator.files import PoseTrack, Quaternion, turned
from estimator.run import Options
from estimator.sources import Frame

Vector = tuple[float, float, float]


class Observed(NamedTuple):
    """The quantities of n frames; NaN where one was not measured.

    Attributes:
        times_s: of the frames, (n,), on their own clock.
        values: of `QUANTITIES`, (n, 6).
        noise: their standard deviations by the spots' covariances, (n, 6).
        no_spot: frames without a spot, by reason.
    """

    times_s: np.ndarray
    values: np.ndarray
    noise: np.ndarray
    no_spot: Counter[str]


def pose_path(poses: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Stamps, and how far the tip then is from the first pose, from rows of stamp and position."""
    return poses[:, 0], np.linalg.norm(poses[:, 1:4] - poses[0, 1:4], axis=1)


def observed(
    source: Path | str,
    *,
    exposure: str | None,
    poses: PoseTrack | None,
    ranger: Ranger | None,
    microscope: Path | None = None,
    eye_from_robot: Quaternion = (0.0, 0.0, 0.0, 1.0),
) -> Observed:
    """Measure a recording.

    Args:
        source: as of `eyespot track`.
        exposure: kind of a stack's images.
        poses: of the robot, on the clock of the source; None for none.
        ranger: for the distances; None for none. Its microscope may have another principal point.
        microscope: file of the source's own microscope; None takes the source's.
        eye_from_robot: unit quaternion that turns the poses' frame into the eye's.

    Raises:
        InputError: the source cannot be measured, or has no times.
    """
    frames = open_source(str(source), exposure=exposure)
    file = microscope or frames.microscope_file
    reader = Options.of({"microscope": file}).reader()
    own = np.array(read_microscope(file).principal_point_px) if file else np.zeros(2)
    times: list[float] = []
    values: list[np.ndarray] = []
    noise: list[np.ndarray] = []

    def note(frame: Frame, reading: Reading) -> None:
        row, spread = (np.full(len(QUANTITIES), math.nan) for _ in range(2))
        spot = reading.result
        if isinstance(spot, Spot):
            row[:ELLIPSE] = spot.ellipse[:ELLIPSE]
            row[:2] -= own
            spread[:ELLIPSE] = np.sqrt(np.diag(spot.covariance)[:ELLIPSE])
            if ranger is not None:
                row[ELLIPSE] = _distance(
                    spot, own, ranger, _axis(poses, frame.time_s, eye_from_robot)
                )
        times.append(frame.time_s)
        values.append(row)
        noise.append(spread)

    tracking = track_source(frames, reader, show=note, write=lambda record: None)
    found = np.array(values)
    if poses is not None:
        rows = np.array([[pose.time_s, *pose.position_mm] for pose in poses])
        stamps, travelled = pose_path(rows)
        found[:, -1] = np.interp(times, stamps, travelled, left=math.nan, right=math.nan)
    return Observed(np.array(times), found, np.array(noise), tracking.no_spot)


def measured_as_planned(
    plan: Plan,
    source: str,
    *,
    poses: Path | None,
    eye_from_robot: str,
    microscope: Path | None,
    start_s: float,
) -> Observed:
    """Measure a recording of a planned experiment, with the plan's calibration, on its clock.

    Args:
        source: as of `eyespot track`.
        poses: of the robot; None takes a stack's.
        microscope: as of `observed`.
        start_s: time in the source at which the planned motion begins.

    Raises:
        InputError: as `observed`, or a file is wrong.
    """
    own = Path(source) / "kinematics.csv"
    file = poses or (own if own.is_file() else None)
    turn = Options.of({"eye_from_robot": eye_from_robot}).eye_from_robot
    assert turn is not None
    with tempfile.TemporaryDirectory() as folder:
        ranger = _planned_ranger(plan, Path(folder))
    seen = observed(
        source,
        exposure=plan.exposure if (Path(source) / "stack.toml").is_file() else None,
        poses=read_poses(file) if file else None,
        ranger=ranger,
        microscope=microscope,
        eye_from_robot=turn,
    )
    return seen._replace(times_s=seen.times_s - start_s)


def _planned_ranger(plan: Plan, folder: Path) -> Ranger | None:
    """The ranger of the plan; None if it has no distances."""
    if plan.calibration is None:
        return None
    files = {"calibration.json": plan.calibration, "microscope.json": plan.microscope}
    for name, content in files.items():
        (folder / name).write_text(json.dumps(content), encoding="utf-8")
    return Ranger(
        read_calibration(folder / "calibration.json"),
        read_microscope(folder / "microscope.json"),
        model=plan.model,
    )


def _axis(poses: PoseTrack | None, time_s: float, turn: Quaternion) -> Vector | None:
    """The tool's axis in the eye's frame, as the robot reports it."""
    known = poses.at(time_s) if poses is not None else None
    return turned(known[0].axis, turn) if known else None


def _distance(spot: Spot, own: np.ndarray, ranger: Ranger, axis: Vector | None) -> float:
    """The distance of a spot, moved to the principal point of the ranger's microscope."""
    x, y = (np.array([spot.x_px, spot.y_px]) - own + ranger.microscope.principal_point_px).tolist()
    return ranger.distance(replace(spot, x_px=x, y_px=y), axis=axis).distance_mm
