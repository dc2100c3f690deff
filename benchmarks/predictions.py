"""`eyespot preregister` and `adjudicate`: what an experiment will measure, and what came true.

A plan is made from a scene before the experiment. A recording is compared with it afterwards.
"""

import hashlib
import json
import math
import tempfile
from collections import Counter
from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Any, NamedTuple, Self

import numpy as np
import pandas as pd
from cyclopts import Parameter
from pydantic import ConfigDict, Field, model_validator
from pydantic import Strict as StrictType

from eyespot.benchmarks.reporting import rows_of
from eyespot.benchmarks.sets.read import plain_spot
from eyespot.benchmarks.sets.spec import scene_value
from eyespot.estimator import Ranger, Reader, track_source
from eyespot.estimator.recording import Recording
from eyespot.estimator.run.options import OUT, Options
from eyespot.estimator.run.progress_bar import progress
from eyespot.formats.calibration import calibration_in, read_calibration
from eyespot.formats.inputs import (
    InputError,
    Strict,
    check_schema,
    in_file,
    object_in,
    read_text,
    validated,
)
from eyespot.formats.microscope import microscope_in
from eyespot.formats.rig import EXACT, rig_in
from eyespot.formats.spot import PARAMETERS
from eyespot.formats.spots import spots_table
from eyespot.formats.whole_files import refuse_existing, write_text
from eyespot.scenes import Scene, World, changed, load_scene, render_stack, scene_toml
from eyespot.scenes.commands import Changes, SceneFile
from eyespot.scenes.world.motion import frame_count, kinematics

SCHEMA = 1
HISTORY = {1: "the first format"}
_MOST_BYTES = 2**28

QUANTITIES = ("x_px", "y_px", "semi_major_px", "semi_minor_px", "distance_mm", "robot_mm")
"""What is predicted for every frame: the spot's ellipse, its centre from the principal point; the
distance, read with the plan's calibration; how far the robot says the tip is from its first pose.
"""
ELLIPSE = 4  # The first four are the ellipse; the distance follows from it.

_SIGMAS_OF_95_PERCENT = 1.959964

_Positive = Annotated[float, Field(gt=0)]
_Table = list[list[float | None]]
_TABLES = ("expected", "low", "high", "noise")


class Plan(Strict):
    """Predictions of n frames, as their file has them; null where nothing is predicted.

    Tables are (n, 6), with a column for each of `QUANTITIES`; `moved` has a table for each
    uncertain key. Publish the SHA-256, and nobody can say later that the plan was another one.
    """

    model_config = ConfigDict(protected_namespaces=())  # `model` is the format's own key

    schema_: Annotated[int, Field(alias="schema")]
    software: str = Field(description="What made the plan.")
    scene: str = Field(description="The planned experiment, as the text of a scene file.")
    exposure: str = Field(description="Kind of the images, as in the scene.")
    calibration: dict[str, Any] | None = Field(
        description="Content of the calibration file for `distance_mm`; null without distances."
    )
    model: str | None = Field(description="Of the distance.")
    microscope: dict[str, Any] = Field(description="Content of the microscope file.")
    uncertain: dict[str, Annotated[tuple[float, _Positive], StrictType(False)]] = Field(
        description="Keys of the scene, each with its value there and its standard uncertainty."
    )
    quantities: list[str] = Field(description="Names of the columns of the tables.")
    times_s: list[float] = Field(description="Of the frames.")
    expected: _Table = Field(description="The quantities, a row a frame.")
    low: _Table = Field(description="Begin of the 95 % intervals, a row a frame.")
    high: _Table = Field(description="End of the 95 % intervals.")
    noise: _Table = Field(description="Standard deviations of the measurement.")
    moved: list[_Table] = Field(
        description="By each uncertain key, for one standard uncertainty of it."
    )
    sha256: str = Field(description="Of everything else in the file.")

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        frames, tables = len(self.times_s), {name: getattr(self, name) for name in _TABLES}
        tables |= zip(self.uncertain, self.moved, strict=False)
        for name, table in tables.items():
            if len(table) != frames or any(len(row) != len(QUANTITIES) for row in table):
                raise InputError(
                    f"the table {name!r} must have {frames} rows of {len(QUANTITIES)} "
                    "numbers, as times_s and quantities say"
                )
        increases = frames > 0 and np.all(np.diff(self.times_s) > 0)
        rules = {
            f"quantities must be {', '.join(QUANTITIES)}": self.quantities == [*QUANTITIES],
            "moved must have a table for each key": len(self.moved) == len(self.uncertain),
            "times_s must have frames and increase": increases,
            "noise must not be negative": not np.any(self.array("noise") < 0),
            "low must not exceed high": not np.any(self.array("low") > self.array("high")),
        }
        for rule, holds in rules.items():
            if not holds:
                raise InputError(rule)
        microscope_in(self.microscope)
        if self.calibration is not None:
            calibration_in(self.calibration)
        return self

    def array(self, name: str) -> np.ndarray:
        """A table of the plan, NaN for null."""
        return np.array(getattr(self, name), float)


def read_plan(path: Path) -> Plan:
    """The plan of a file; InputError if it is none, or was changed since it was made."""
    remedy = "Restore the file."
    with in_file(path):
        content = object_in(read_text(path, most_bytes=_MOST_BYTES))
        check_schema(content.get("schema"), HISTORY, remedy=remedy)
        plan = validated(Plan, content, remedy=remedy)
        made = _sha256(content)
        if made != plan.sha256:
            raise InputError(
                f"the plan was changed after it was made: its SHA-256 is {made[:12]}…, and it says "
                f"{plan.sha256[:12]}…. {remedy}"
            )
    return plan


def _sha256(content: Mapping[str, Any]) -> str:
    """Of a plan's content in whatever order and layout, without the sum that it states."""
    stated = {key: value for key, value in content.items() if key != "sha256"}
    text = json.dumps(stated, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()


# What a recording says about the quantities of a plan.

_SIGMAS = [f"sigma_{name}" for name in QUANTITIES[:ELLIPSE]]


def _travelled(times: Any, positions: Any, at: Any) -> np.ndarray:
    """How far the tip is from its first position at some times, mm; NaN outside of its own."""
    far = np.linalg.norm(positions - positions[0], axis=1)
    return np.interp(at, times, far, left=np.nan, right=np.nan)


def _observed(recording: Recording, reader: Reader) -> pd.DataFrame:
    """Measure a recording on its own clock, as `eyespot track` does; a row a frame.

    Among the columns are `time_s`, `QUANTITIES` (NaN where one was not measured), `sigma_` of the
    ellipse by the spot's covariance, and `no_spot`, why there is no spot.
    """
    seen = spots_table(track_source(recording, reader).records)
    if recording.view is not None:
        seen[["x_px", "y_px"]] -= np.array(recording.view.principal_point_px)
    seen[_SIGMAS] = np.sqrt(seen[[f"cov_{name}_{name}" for name in PARAMETERS[:ELLIPSE]]])
    seen["no_spot"] = seen.reason.where(seen.status == "no_spot")
    seen["robot_mm"] = math.nan
    if (poses := recording.poses()) is not None:
        stamps, positions = zip(*((pose.time_s, pose.position_mm) for pose in poses), strict=True)
        seen["robot_mm"] = _travelled(stamps, np.array(positions), seen.time_s)
    return seen


# A plan from a scene, stated uncertainties of its keys, and a rehearsal.

_ROUNDED_POSE_MM = 1e-5  # Files round poses to it.


def predicted(
    scene: Scene,
    uncertain: Mapping[str, float],
    *,
    calibration: Path | None = None,
    model: str | None = None,
) -> Plan:
    """The plan of an experiment, with the arguments of `eyespot preregister`.

    What is expected is the exact geometry of the scene. How far a stated key moves it is the
    difference between two scenes, one standard uncertainty to either side. The noise, and in which
    frames there is a spot at all, are those of a rehearsal: the scene is rendered and measured.

    Raises:
        InputError: a key is unknown or no number, or a scene beside the planned one is impossible.
    """
    kinds = scene.exposures.kinds
    kind = "metered" if "metered" in kinds else kinds[0]
    stated = {key: _stated(scene, key, sigma) for key, sigma in uncertain.items()}
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary) / "rehearsal"
        with progress("Rehearsing", total=frame_count(scene)) as advance:
            render_stack(scene, folder, progress=advance)
        microscope = json.loads((folder / "microscope.json").read_text())
        rehearsal = Recording.open(folder, exposure=kind)
        seen = _observed(rehearsal, Options().reader(rehearsal.rig))
    ranger = None
    if calibration is not None:
        ranger = Ranger(read_calibration(calibration), microscope_in(microscope), model=model)
    world = World(scene)
    times = np.asarray(world.times)
    expected = _exact(world, times, ranger)
    noise = np.full(expected.shape, np.nan)
    noise[:, :ELLIPSE] = seen[_SIGMAS]
    if ranger is not None:
        # From the semi-minor axis to the distance, as of the cone: (d + |b|) / e1'.
        reach = np.abs(expected[:, ELLIPSE] - ranger.calibration.values["b"])
        noise[:, ELLIPSE] = reach / expected[:, ELLIPSE - 1] * noise[:, ELLIPSE - 1]
    jitter = math.hypot(scene.clocks.kinematics_jitter_s, scene.clocks.camera_jitter_s)
    noise[:, -1] = np.hypot(np.asarray(world.speed) * jitter, _ROUNDED_POSE_MM)
    beside = [
        [_exact(World(changed(scene, {key: value + by})), times, ranger) for by in (-sigma, sigma)]
        for key, (value, sigma) in stated.items()
    ]
    down, up = np.moveaxis(np.reshape(beside, (-1, 2, *expected.shape)), 1, 0)
    # What is not proportional to an error, as where a motion begins, counts as noise.
    noise = np.sqrt(noise**2 + np.sum(((up + down) / 2 - expected) ** 2, axis=0))
    # Where the rehearsal has no spot, none is predicted.
    expected = np.where(np.isnan(noise), np.nan, expected)
    moved = np.where(np.isnan(noise), np.nan, (up - down) / 2)
    half = _SIGMAS_OF_95_PERCENT * np.sqrt(noise**2 + np.sum(moved**2, axis=0))
    tables = {"expected": expected, "low": expected - half, "high": expected + half}
    content = {
        "schema": SCHEMA,
        "software": f"eyespot {version('eyespot')}",
        "scene": scene_toml(scene),
        "exposure": kind,
        "calibration": json.loads(calibration.read_text()) if calibration else None,
        "model": ranger.model if ranger else None,
        "microscope": microscope,
        "uncertain": stated,
        "quantities": list(QUANTITIES),
        "times_s": times.tolist(),
        # JSON has no NaN.
        **{
            name: np.where(np.isnan(table), np.array(None), table.astype(object)).tolist()
            for name, table in (tables | {"noise": noise, "moved": moved}).items()
        },
    }
    made = content | {"sha256": _sha256(content)}
    return validated(Plan, made, remedy="Change the scene.")


def _stated(scene: Scene, key: str, sigma: float) -> tuple[float, float]:
    """The value of an uncertain key of the scene, and its standard uncertainty."""
    if not 0 < sigma < math.inf:
        raise InputError(f"the uncertainty of {key} must be positive and finite; got {sigma}.")
    found = scene_value(scene, key)
    if found is None:
        changed(scene, {key: 0.0})  # the scene says which keys are near
    if isinstance(found, bool) or not isinstance(found, float | int) or not math.isfinite(found):
        raise InputError(
            f"{key} is {found!r}, not a number with an uncertainty. Name a key of the scene such as"
            " phantom.radius_mm; `eyespot scene init` lists them."
        )
    changed(scene, {key: found})  # refuses what follows from keys, such as phantom.mean_radius_mm
    return found, sigma


def _exact(world: World, times: np.ndarray, ranger: Ranger | None) -> np.ndarray:
    """The quantities by geometry, (n, 6)."""
    spread = world.spread_spots
    ellipse = (world.truth if spread is None else spread).half_max
    # The window of a scene follows its spot; a microscope's does not.
    centre = np.asarray(ellipse.centre) - np.asarray(world.microscope.principal_point)
    found = np.full((len(times), len(QUANTITIES)), np.nan)
    found[:, :ELLIPSE] = np.column_stack([centre, ellipse.semi_major, ellipse.semi_minor])
    if ranger is not None:
        at = ranger.microscope.principal_point_px
        beams = np.asarray(world.truth.beam.axis)
        for row, angle, beam in zip(found, np.asarray(ellipse.angle), beams, strict=True):
            x, y = row[:2] + at
            spot = plain_spot(x, y, row[2], row[3], angle, np.eye(5))
            row[ELLIPSE] = ranger.distance(spot, axis=beam).distance_mm
    # The robot reports its poses; the jitter of its clock is noise.
    still = changed(world.scene, {"clocks.kinematics_jitter_s": 0.0})
    reported = kinematics(still, world.motion)
    found[:, -1] = _travelled(reported[:, 0], reported[:, 1:4], times)
    return found


# A recording against its plan: hits, misses, and what explains the misses.

CHANGED_SIGMAS = 3.0  # By chance one value in 400 is off by more.

_FREE_KEY_SIGMAS = 1e6  # A prior this wide leaves a key free.


class Judgement(NamedTuple):
    """Which predictions held, in number and by quantity.

    Attributes:
        quantities: by quantity: hits in the interval; misses, of which some are unmeasured; RMS of
            measured minus predicted over the standard uncertainty.
        keys: by uncertain key, the farthest first: value as stated and as the recording agrees with
            best, their standard uncertainties, and the pull between the two in such.
        misfit: RMS of what remains with the best values of all keys, over the noise.
        no_spot: frames without a spot, by reason.
    """

    held: int
    predictions: int
    quantities: pd.DataFrame
    keys: pd.DataFrame
    misfit: float
    no_spot: Counter[str]


def judged(
    plan: Plan,
    source: str,
    *,
    poses: Path | None = None,
    rig: Path | None = None,
    start_s: float = 0.0,
) -> Judgement:
    """Measure a recording with the plan's calibration, and compare; arguments of `adjudicate`.

    Raises:
        InputError: a file is wrong, the source cannot be measured, or no frame has one of the
            plan's times.
    """
    is_stack = (Path(source) / "stack.toml").is_file()
    exposure = plan.exposure if is_stack else None
    frames = Recording.open(source, rig=rig, poses=poses, exposure=exposure)
    if frames.view is None:
        planned = rig_in(EXACT | {"seen": microscope_in(plan.microscope)}, where="plan")
        frames = Recording(frames.source, poses=poses, rig=planned)
    if poses is None and is_stack:
        frames = Recording(frames.source, poses=frames.robot(), rig=frames.rig)
    options, beam = Options(), None
    if plan.calibration is not None:
        beam = calibration_in(plan.calibration)
        options = Options.of({"mode": "subpixel", "model": plan.model})
    seen = _observed(frames, options.reader(frames.rig, beam))
    seen["time_s"] -= start_s
    # A frame that is jittered beyond the plan's ends is still its first or last.
    step = float(np.median(np.diff(plan.times_s))) if len(plan.times_s) > 1 else math.inf
    inside = seen.time_s.between(plan.times_s[0] - step / 2, plan.times_s[-1] + step / 2)

    def at_frames(table: np.ndarray) -> np.ndarray:
        columns = [np.interp(seen.time_s, plan.times_s, column) for column in table.T]
        return np.where(inside.to_numpy()[:, None], np.transpose(columns), np.nan)

    expected, noise = (at_frames(plan.array(name)) for name in ("expected", "noise"))
    if np.isnan(expected).all():
        raise InputError(
            f"no frame has a time from {plan.times_s[0]:g} to {plan.times_s[-1]:g} s, for which the"
            " plan has predictions. --begin says when the motion begins."
        )
    moved = np.reshape([at_frames(of) for of in plan.array("moved")], (-1, *expected.shape))
    off = seen[list(QUANTITIES)].to_numpy() - expected
    pulls = off / np.sqrt(noise**2 + np.sum(moved**2, axis=0))
    made, hits = ~np.isnan(expected), np.abs(pulls) <= _SIGMAS_OF_95_PERCENT
    tallies = pd.DataFrame(
        {
            "hits": hits.sum(axis=0),
            "misses": (made & ~hits).sum(axis=0),
            "unmeasured": (made & np.isnan(pulls)).sum(axis=0),
            "rms": np.sqrt((pd.DataFrame(pulls) ** 2).mean()),
        }
    )
    tallies.insert(0, "quantity", QUANTITIES)
    # No poses, no prediction about them; but a spot that is not there is a miss.
    tallies = tallies[made.any(axis=0) & ~((tallies.quantity == "robot_mm") & tallies.rms.isna())]
    held, missed = tallies[["hits", "misses"]].sum().tolist()
    explained = _explained(plan, off / noise, moved / noise)
    return Judgement(held, held + missed, tallies, *explained, Counter(seen.no_spot.dropna()))


def _explained(plan: Plan, residual: np.ndarray, moved: np.ndarray) -> tuple[pd.DataFrame, float]:
    """Each key fitted freely while the others keep to what is stated; and what then remains.

    A least-squares fit of all keys, with a prior of one standard uncertainty for all but the key in
    question. The distance follows from the ellipse and does not count again.
    """
    used = ~np.isnan(residual) & ~np.isnan(moved).any(axis=0)
    used[:, ELLIPSE] = False
    data, design = residual[used], moved[:, used].T

    def fit(noise: float, prior: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        slopes = design / noise
        covariance = np.linalg.inv(slopes.T @ slopes + np.diag(prior))
        return covariance @ (slopes.T @ (data / noise)), covariance

    prior = np.ones(len(plan.uncertain))
    best, _ = fit(1.0, prior)
    misfit = float(np.sqrt(np.mean((data - design @ best) ** 2))) if data.size else math.nan
    rows = []
    for n, (key, (stated, unit)) in enumerate(plan.uncertain.items()):
        free = prior.copy()
        free[n] = 1 / _FREE_KEY_SIGMAS**2
        # What no key explains is noise for them all (Birge 1932).
        found, covariance = fit(max(1.0, misfit), free)
        off, error = float(found[n]), math.sqrt(covariance[n, n])
        pull = off / math.hypot(1.0, error)
        rows.append((key, stated, unit, stated + unit * off, unit * error, pull))
    names = ["key", "stated", "stated_sigma", "found", "found_sigma", "pull"]
    keys = pd.DataFrame(rows, columns=names)
    keys["contradicts"] = keys.pull.abs() > CHANGED_SIGMAS
    return keys.sort_values("pull", key=lambda pull: -pull.abs(), kind="stable"), misfit


# The commands.

_POOR = 10.0
"""Times the noise. A wall's texture moves spots by some times their noise, another lens by more."""


def preregister(
    scene: SceneFile,
    /,
    *,
    out: Annotated[Path, OUT],
    uncertain: Annotated[tuple[str, ...], Parameter(metavar="KEY=SIGMA", show_default=False)] = (),
    changes: Changes = (),
    calibration: Path | None = None,
    model: str | None = None,
) -> None:
    """Write down what an experiment will measure, with intervals, before it is done.

    The SHA-256 that is printed proves later that the plan was not changed: publish it.

    Args:
        out: Plan to write (JSON); must not exist.
        uncertain: Standard uncertainty of a number in the scene, for example phantom.radius_mm=0.2.
            Repeatable.
        calibration: Calibration file with which distances will be read.
        model: Distance model (default: the calibration file's).
    """
    refuse_existing(out)
    if model is not None and calibration is None:
        raise InputError("model has no effect without calibration. Give both, or neither.")
    settings, sigmas = load_scene(scene, changes), {}
    for text in uncertain:
        key, _, sigma = (part.strip() for part in text.partition("="))
        try:
            sigmas[key] = float(sigma)
        except ValueError:
            raise InputError(
                f"--uncertain must be KEY=SIGMA, such as phantom.radius_mm=0.2; got {text!r}."
            ) from None
    plan = predicted(settings, sigmas, calibration=calibration, model=model)
    write_text(out, plan.model_dump_json(by_alias=True) + "\n")
    print(f"Wrote {out}: {len(plan.times_s)} frames.\nSHA-256 {plan.sha256}")


def adjudicate(
    plan: Path,
    source: str,
    /,
    *,
    poses: Path | None = None,
    rig: Path | None = None,
    start_s: Annotated[float, Parameter("--begin")] = 0.0,
    as_json: Annotated[bool, Parameter("--json")] = False,
) -> None:
    """Say which predictions of a plan held, and what explains those that did not.

    Args:
        plan: File of `eyespot preregister`.
        source: Stack, folder of images, TIFF, video, or ROS bag.
        poses: Robot poses (CSV or ROS bag), on the clock of SOURCE (default: the stack's).
        rig: Rig file of SOURCE (default: the stack's).
        start_s: Time in SOURCE at which the planned motion begins.
        as_json: Print the result as one JSON object, and nothing else.
    """
    agreed = read_plan(plan)
    found = judged(agreed, source, poses=poses, rig=rig, start_s=start_s)
    if as_json:
        tables = {name: getattr(found, name).to_dict("records") for name in ("quantities", "keys")}
        print(json.dumps({"plan_sha256": agreed.sha256} | found._asdict() | tables))
        return
    print(f"Plan {plan}, SHA-256 {agreed.sha256}")
    names = {"hits": "held", "misses": "missed", "unmeasured": "of these not measured"}
    table = found.quantities.rename(columns=names | {"rms": "RMS deviation, σ"})
    print(table.to_string(index=False, float_format="{:.2f}".format))
    share = 100 * found.held / found.predictions
    print(f"{found.held} of {found.predictions} predictions held ({share:.1f} %).")
    wrong = found.keys[found.keys.contradicts]
    for cause in rows_of(wrong):
        print(
            f"Contradicted: {cause.key} was stated as {cause.stated:.6g} ± "
            f"{cause.stated_sigma:.2g}; the recording says {cause.found:.6g} ± "
            f"{cause.found_sigma:.2g}, {abs(cause.pull):.1f} σ apart."
        )
    if len(wrong) > 1:
        print("If one of these is corrected, the others may agree. Begin with the first.")
    if found.misfit > _POOR:
        best = "With the best values of all keys" if len(wrong) else "Whatever the stated keys are,"
        print(
            f"{best} {found.misfit:.0f} times the noise remains: the plan is linear in its keys, "
            "or something differs that it takes as certain."
        )
    elif wrong.empty:
        print("Nothing that was stated is contradicted.")
    if found.no_spot:
        reasons = ", ".join(f"{n} {reason}" for reason, n in found.no_spot.most_common())
        print(f"Frames without a spot: {reasons}.")
