"""The plan's file: JSON with predictions, their intervals, and a SHA-256 of all of it."""

from __future__ import annotations

import hashlib
import json
import math
import tempfile
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
import pandas as pd
from pydantic import ConfigDict, Field
from pydantic import Strict as StrictType

from estimator import (
    Ranger,
    Reading,
    Spot,
    open_source,
    read_calibration,
    read_microscope,
    track_source,
)
from estimator.files import PoseTrack, Quaternion, object_in, read_poses, turned, written_whole
from estimator.run import Options
from estimator.sources import Frame
from optics import InputError, Strict, check_schema, in_file, read_text, validated
from scenes import Scene, World, changed, render_stack, scene_toml
from scenes.world import kinematics

SCHEMA = 1
HISTORY = {1: "the first format"}
"""What changed with each version of the format that is read."""

_MOST_BYTES = 2**28

QUANTITIES = ("x_px", "y_px", "semi_major_px", "semi_minor_px", "distance_mm", "robot_mm")
"""What is predicted for every frame.

x_px, y_px: centre of the spot from the principal point; semi_major_px, semi_minor_px: of its
ellipse; distance_mm: read with the plan's calibration; robot_mm: how far the robot says that the
tip is from its first pose.
"""

ELLIPSE = 4
"""The first of them are the spot's ellipse, from which the distance follows."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Plan:
    """Predictions of n frames; NaN where nothing is predicted.

    Attributes:
        scene: the planned experiment, as the text of a scene file.
        software: that made the plan.
        exposure: kind of the images, as in the scene.
        calibration: content of the calibration file for `distance_mm`; None without distances.
        model: of the distance.
        microscope: content of the microscope file.
        uncertain: keys of the scene, each with its value there and its standard uncertainty.
        times_s: of the frames, (n,).
        expected: of `QUANTITIES`, (n, 6).
        noise: standard deviations of the measurement, (n, 6).
        moved: by each uncertain key, for one standard uncertainty of it, (keys, n, 6).
    """

    scene: str
    software: str
    exposure: str
    calibration: dict[str, Any] | None
    model: str | None
    microscope: dict[str, Any]
    uncertain: dict[str, tuple[float, float]]
    times_s: np.ndarray
    expected: np.ndarray
    noise: np.ndarray
    moved: np.ndarray

    @property
    def sigma(self) -> np.ndarray:
        """Standard uncertainty of each prediction: what is stated, and the noise, (n, 6)."""
        return np.sqrt(self.noise**2 + np.sum(self.moved**2, axis=0))


_Positive = Annotated[float, Field(gt=0)]


class _PlanFile(Strict):
    model_config = ConfigDict(protected_namespaces=())  # `model` is the format's own key

    schema_: Annotated[int, Field(alias="schema")]
    software: str
    scene: str
    exposure: str
    calibration: dict[str, Any] | None
    model: str | None
    microscope: dict[str, Any]
    uncertain: dict[str, Annotated[tuple[float, _Positive], StrictType(False)]]
    quantities: list[str]
    times_s: list[float]
    expected: list[list[float | None]]
    low: list[list[float | None]]
    high: list[list[float | None]]
    noise: list[list[float | None]]
    moved: list[list[list[float | None]]]
    sha256: str


def write_plan(path: Path, plan: Plan) -> str:
    """Write a plan, whole or not at all.

    Returns:
        Its SHA-256: publish it, and nobody can say later that the plan was another one.
    """
    half = 1.959964 * plan.sigma
    content = {"schema": SCHEMA, **asdict(plan), "quantities": list(QUANTITIES)}
    content |= {"low": plan.expected - half, "high": plan.expected + half}
    content = {name: _plain(value) for name, value in content.items()}
    content["sha256"] = fingerprint_of(content)
    with written_whole(path) as partial:
        partial.write_text(json.dumps(content) + "\n", encoding="utf-8")
    return str(content["sha256"])


def read_plan(path: Path) -> tuple[Plan, str]:
    """A plan and its SHA-256.

    Raises:
        InputError: not a plan, or changed since it was made.
        OSError: the file cannot be read.
    """
    remedy = "Restore the file."
    with in_file(path, InputError):
        content = object_in(read_text(path, most_bytes=_MOST_BYTES))
        check_schema(content.get("schema"), HISTORY, remedy=remedy)
        file = validated(_PlanFile, content, remedy=remedy)
        made = fingerprint_of({key: value for key, value in content.items() if key != "sha256"})
        if made != file.sha256:
            raise InputError(
                f"the plan was changed after it was made: its SHA-256 is {made[:12]}…, and it says "
                f"{file.sha256[:12]}…. {remedy}"
            )
        if file.quantities != list(QUANTITIES):
            raise InputError(f"quantities must be {', '.join(QUANTITIES)}. {remedy}")
    return (
        Plan(
            scene=file.scene,
            software=file.software,
            exposure=file.exposure,
            calibration=file.calibration,
            model=file.model,
            microscope=file.microscope,
            uncertain=file.uncertain,
            times_s=np.array(file.times_s),
            expected=np.array(file.expected, float),
            noise=np.array(file.noise, float),
            moved=np.array(file.moved, float),
        ),
        made,
    )


def fingerprint_of(content: dict[str, Any]) -> str:
    """SHA-256 of a content, in whatever order and layout it is written."""
    text = json.dumps(content, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()


def _plain(value: Any) -> Any:
    """Arrays as lists, with null for NaN."""
    if not isinstance(value, np.ndarray):
        return value
    found = value.astype(object)
    found[np.isnan(value)] = None
    return found.tolist()


# What a recording says about the quantities of a plan.

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


# Makes a plan from a scene, stated uncertainties of its keys, and a rehearsal.

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


# Compares a recording with a plan: hits, misses, and what explains the misses.

SURE = 3.0
"""Standard deviations from which a value counts as another one: 1 in 400 by chance."""

_WIDE = 1e6  # of a key that is fitted freely, in its standard uncertainties
_WITHIN = 1.959964


class Judgement(NamedTuple):
    """Which predictions held.

    Attributes:
        tallies: by quantity: hits in the interval; misses, of which some are unmeasured; RMS of
            measured minus predicted over the standard uncertainty.
        causes: by uncertain key, the farthest first: value as stated and as the recording agrees
            with best, their standard uncertainties, and the pull between the two in such.
        misfit: of what remains with the best values of all keys, over the noise, RMS.
        no_spot: frames without a spot, by reason.
    """

    tallies: pd.DataFrame
    causes: pd.DataFrame
    misfit: float
    no_spot: Counter[str]

    @property
    def hits(self) -> int:
        """Predictions that held."""
        return int(self.tallies.hits.sum())

    @property
    def predictions(self) -> int:
        """Predictions in all."""
        return self.hits + int(self.tallies.misses.sum())


def judged(plan: Plan, seen: Observed) -> Judgement:
    """Compare a recording with a plan.

    Args:
        seen: the recording, on the plan's clock.

    Raises:
        InputError: no frame was taken at a time that the plan has.
    """
    expected, noise, moved = _at(plan, seen.times_s)
    if np.isnan(expected).all():
        raise InputError(
            f"no frame has a time from {plan.times_s[0]:g} to {plan.times_s[-1]:g} s, for which the"
            " plan has predictions. --begin says when the motion begins."
        )
    sigma = np.sqrt(noise**2 + np.sum(moved**2, axis=0))
    pulls = (seen.values - expected) / sigma
    rows = []
    for name, pull, wanted in zip(QUANTITIES, pulls.T, expected.T, strict=True):
        # No poses, no prediction about them; but a spot that is not there is a miss.
        if np.isnan(wanted).all() or (name == "robot_mm" and np.isnan(pull).all()):
            continue
        predicted, measured = ~np.isnan(wanted), pull[~np.isnan(pull)]
        hits = int(np.sum(np.abs(pull) <= _WITHIN))
        missing = int(np.sum(np.isnan(pull) & predicted))
        rms = float(np.sqrt(np.mean(measured**2))) if measured.size else math.nan
        rows.append((name, hits, int(predicted.sum()) - hits, missing, rms))
    tallies = pd.DataFrame(rows, columns=["quantity", "hits", "misses", "unmeasured", "rms"])
    causes, misfit = _explained(plan, (seen.values - expected) / noise, moved / noise)
    return Judgement(tallies, causes, misfit, seen.no_spot)


def _at(plan: Plan, times: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Expected values, noise, and what moves them, at the times of frames; NaN outside."""
    # A frame that is jittered beyond the plan's ends is still its first or last.
    step = float(np.median(np.diff(plan.times_s))) if len(plan.times_s) > 1 else math.inf
    low, high = plan.times_s[0], plan.times_s[-1]
    inside = (times >= low - step / 2) & (times <= high + step / 2)

    def columns(table: np.ndarray) -> np.ndarray:
        found = [np.interp(times, plan.times_s, column) for column in table.T]
        return np.where(inside[:, None], np.array(found).T, np.nan)

    moved = [columns(table) for table in plan.moved]
    shape = (len(moved), len(times), len(QUANTITIES))
    return columns(plan.expected), columns(plan.noise), np.array(moved).reshape(shape)


def _explained(plan: Plan, residual: np.ndarray, moved: np.ndarray) -> tuple[pd.DataFrame, float]:
    """Each key fitted freely while the others keep to what is stated; and what then remains.

    The least-squares fit of all keys, each in its standard uncertainties and with a prior of one of
    them; the key in question has none. The distance follows from the ellipse and does not count
    again.
    """
    counted = np.ones(len(QUANTITIES), bool)
    counted[ELLIPSE] = False
    used = ~np.isnan(residual) & ~np.isnan(moved).any(axis=0) & counted
    data = residual[used]
    design = np.array([table[used] for table in moved]).reshape(len(moved), data.size).T
    keys = list(plan.uncertain)
    best = _fit(design, data, np.ones(len(keys)))[0]
    misfit = float(np.sqrt(np.mean((data - design @ best) ** 2))) if data.size else math.nan
    # What no key explains is noise for them all (Birge 1932).
    scale = max(1.0, misfit)
    rows = []
    for index, key in enumerate(keys):
        prior = np.ones(len(keys))
        prior[index] = 1 / _WIDE
        found, covariance = _fit(design / scale, data / scale, prior)
        error = math.sqrt(covariance[index, index])
        stated, unit = plan.uncertain[key]
        pull = float(found[index]) / math.hypot(1.0, error)
        value = stated + unit * float(found[index])
        rows.append((key, stated, unit, value, unit * error, pull, abs(pull) > SURE))
    names = ["key", "stated", "stated_sigma", "found", "found_sigma", "pull", "contradicts"]
    causes = pd.DataFrame(rows, columns=names)
    return causes.sort_values("pull", key=lambda pull: -pull.abs(), kind="stable"), misfit


def _fit(design: np.ndarray, data: np.ndarray, prior: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Least squares with a prior of 0 and weights `prior`; the estimate and its covariance."""
    normal = design.T @ design + np.diag(prior**2)
    covariance = np.linalg.inv(normal)
    return covariance @ (design.T @ data), covariance
