"""The mode pixels on drawn stacks: errors, stated errors, memory.

The true beam is known. The robot says the beam's axis with an error of 5 degrees, one draw a stack,
and the tip's relative motion; nothing says the distance. The sub-pixel mode measures the same
frames. Stacks are drawn anew from a seed: wall, beam, motion, place, tilt, texture and noise.
"""

import math
import tempfile
import time
from collections.abc import Callable
from itertools import cycle, islice
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from scipy.stats import chi2

from eyespot import optics
from eyespot.benchmarks.bench.load import memory_mb
from eyespot.benchmarks.sets.read import own_reader, true_beam
from eyespot.benchmarks.statistics import largest, rms
from eyespot.benchmarks.studies.pose import PRIOR_DEG, drawn_prior
from eyespot.estimator.distance.range import TipPose
from eyespot.estimator.recording import Recording
from eyespot.estimator.run.options import Options
from eyespot.estimator.run.reader import Reader
from eyespot.estimator.sources.opening import open_source
from eyespot.formats.microscope import read_microscope
from eyespot.formats.poses import Pose, PoseTrack, read_poses
from eyespot.formats.stack import FrameLabels, Stack
from eyespot.scenes import Scene, SceneError, render_stack
from eyespot.scenes.world.world import World


def frame_errors(stack: Stack, rng: np.random.Generator, *, alone_every: int = 0) -> pd.DataFrame:
    """Errors of the frames of a stack, read in their order: mm, degrees and px, NaN without a pose.

    `doubt` is of the pose, or says why there is none; `posed`: there is one without a doubt.
    `half_maximum_px` is the semi-minor axis of the half-maximum ellipse at the pose,
    `subpixel_px` the one that sub-pixel mode measures, both less the true one. See `errors_of`.

    Args:
        alone_every: the first of each so many frames is read as if nothing came before it; 0: only
            the stack's first.
    """
    world = World(Scene.model_validate(stack.description["scene"]))
    reader, poses = informed_reader(stack), noisy_poses(stack, rng)
    start = stack.labels[0].half_max_x_px, stack.labels[0].half_max_y_px
    microscope = read_microscope(stack.folder / "microscope.json")
    subpixel, rows = own_reader("subpixel", microscope, click=start), []
    for number, (frame, labels) in enumerate(
        zip(open_source(stack.folder), stack.labels, strict=True)
    ):
        if alone_every and number % alone_every == 0:
            reader.forget()
            subpixel.forget()
        began = time.perf_counter()
        read = reader.read(frame, poses=poses)
        seconds, true_px = time.perf_counter() - began, labels.half_max_semi_minor_px
        spot, at_pose = subpixel.read(frame).result, math.nan
        pose = read.range.poses[0] if read.range and read.range.poses else None
        if pose is not None:
            at_pose = float(half_maximum_px(world, pose.tip_mm[None], pose.axis)[0]) - true_px
        rows.append(
            {
                "frame": number,
                "distance_mm": read.distance_mm - labels.d_mm,
                "sigma_mm": read.sigma_distance_mm,
                **errors_of(pose, labels),
                "half_maximum_px": at_pose,
                "subpixel_px": spot.semi_minor_px - true_px if spot else math.nan,
                "doubt": read.doubt,
                "seconds": seconds,
            }
        )
    frames = pd.DataFrame(rows)
    return frames.assign(
        posed=frames.distance_mm.notna() & (frames.doubt == ""),
        d_chi_squared=(frames.distance_mm / frames.sigma_mm) ** 2,
    )


def informed_reader(stack: Stack) -> Reader:
    """A reader that knows the beam, how well the robot says the axis, and how the view shakes."""
    shake_px = stack.described("scene.unrest.shake_px", float)
    known = {"robot.axis_sigma_deg": PRIOR_DEG, "unrest.shake_px": shake_px}
    rig = Recording.open(stack, changes=known).rig
    reader = Options(mode="pixels").reader(rig, true_beam(stack))
    reader.prepare()
    return reader


def noisy_poses(stack: Stack, rng: np.random.Generator) -> PoseTrack:
    """The robot's poses of a stack, all with one drawn error of the axis."""
    axis = np.array(stack.labels[0].axis)
    turn = drawn_prior(axis, rng) - axis
    told = []
    for pose in read_poses(stack.folder / "kinematics.csv"):
        turned = np.array(pose.axis) + turn
        x, y, z = (turned / np.linalg.norm(turned)).tolist()
        told.append(Pose.along((x, y, z), time_s=pose.time_s, position_mm=pose.position_mm))
    return PoseTrack(told)


def errors_of(pose: TipPose | None, labels: FrameLabels) -> dict[str, float]:
    """Errors of tip (mm) and axis (degrees), and squares of Mahalanobis distances by their part."""
    parts = {"pose": slice(None), "tip": slice(3), "axis": slice(3, None)}
    if pose is None:
        names = "tip_mm", "axis_deg", "sigma_axis_deg", *(f"{part}_chi_squared" for part in parts)
        return dict.fromkeys(names, math.nan)
    assert pose.covariance is not None
    off = pose.less(labels.tip_mm, labels.axis)
    sigma = math.sqrt(pose.covariance[3, 3] + pose.covariance[4, 4])
    return {
        "tip_mm": float(np.linalg.norm(off[:3])),
        "axis_deg": math.degrees(np.linalg.norm(off[3:])),
        "sigma_axis_deg": math.degrees(sigma),
        **{
            f"{name}_chi_squared": pose.chi_squared(labels.tip_mm, labels.axis, part=part)
            for name, part in parts.items()
        },
    }


def half_maximum_px(world: World, tips: np.ndarray, axis: np.ndarray) -> np.ndarray:
    """Semi-minor axes of the half-maximum ellipses of the true beam at tips, n x 3, px."""
    truth = optics.spot_truth(
        world.wall,
        world.microscope,
        world.table,
        tip=tips,
        axis=np.broadcast_to(axis, tips.shape),
        half_angle=world.cone.half_angle,
        apex_offset=world.cone.apex_offset,
    )
    return np.asarray(truth.half_max.semi_minor)


BEAMS: dict[str, dict[str, Any]] = {
    "cone": {"kind": "cone"},
    "dome, vitreous": {"kind": "lens", "lens": "dome", "medium": "vitreous"},
    "candidate, air": {"kind": "lens", "lens": "paper-candidate", "medium": "air"},
}
WALLS = ("uniform", "printed paper", "retina", "photograph")
MM_PER_FRAME = 2.0 / 12  # A withdrawal's step.
_HALF_FIELD_MM = 2.2  # So far every wall has a picture.
_MAX_DRAWS = 50  # A scene is drawn until its spot lies in the window.


def drawn_stack(
    folder: Path,
    rng: np.random.Generator,
    *,
    beam: str,
    wall: str,
    motion: str,
    frames: int,
    between_mm: tuple[float, float] = (1.0, 3.5),
) -> Stack:
    """Draw scenes until one is possible, and render it; SceneError if none is.

    The beam is one of `BEAMS`, the wall one of `WALLS`, the motion "withdrawal" or "hand".
    `between_mm` are bounds of a withdrawal's first distance, or a hand's mean one.
    """
    for _ in range(_MAX_DRAWS):
        seed, distance = int(rng.integers(1, 2**31)), float(rng.uniform(*between_mm))
        travel = {"travel_mm": MM_PER_FRAME * frames, "frames": frames, "speed_mm_s": 1.0}
        # A hand's motion ends in the middle between frames.
        hand = {"duration_s": 0.1 * frames - 0.05, "top_speed_mm_s": 2.0, "seed": seed}
        moves: dict[str, dict[str, Any]] = {
            "withdrawal": {"start_mm": distance, **travel},
            "hand": {"kind": "hand", "distance_mm": distance, **hand},
        }
        scene: dict[str, Any] = {
            "schema": 1,
            "seed": seed,
            "phantom": {"wall": wall, "texture_seed": seed},
            "instrument": {"visible": False},
            "source": BEAMS[beam],
            "spot": {
                "eccentricity_mm": float(rng.uniform(0, _HALF_FIELD_MM)),
                "azimuth_deg": float(rng.uniform(60, 120)),
                "incidence_deg": float(rng.uniform(10, 30)),
                "incidence_azimuth_deg": float(rng.uniform(0, 360)),
            },
            "motion": moves[motion],
            "exposures": {"kinds": ["metered"]},
        }
        try:
            return render_stack(Scene.model_validate(scene), folder)
        except SceneError as error:  # the drawn spot leaves the window
            refused = error
    raise refused


# The benchmarks.

_WRONG_CHANCE = 1e-4  # For all frames together: of a chi squared that no honest pose has.


def _of_frames(frames: pd.DataFrame) -> pd.Series:
    """What frames show; errors are RMS over the frames with a pose without a doubt."""
    posed = frames[frames.posed]
    return pd.Series(
        {
            "frames": len(frames),
            "with_a_pose": len(posed),
            # Poses whose chi squared no honest estimator has in so many frames.
            "silently_wrong": (
                posed.pose_chi_squared > chi2.isf(_WRONG_CHANCE / len(frames), 5)
            ).sum(),
            "median_ms": 1e3 * frames.seconds.median(),
            "d_um": 1e3 * rms(posed.distance_mm),
            "d_stated_um": 1e3 * rms(posed.sigma_mm),
            "d_largest_um": 1e3 * largest(posed.distance_mm),
            "tip_um": 1e3 * rms(posed.tip_mm),
            "axis_deg": rms(posed.axis_deg),
            "axis_stated_deg": rms(posed.sigma_axis_deg),
            # Semi-minor axes: of half maximum at the pose, and as sub-pixel mode measures it.
            "half_maximum_px": rms(posed.half_maximum_px),
            "subpixel_px": rms(posed.subpixel_px),
            "chi_squared_over_5": posed.pose_chi_squared.mean() / 5,
            "largest_chi_squared": posed.pose_chi_squared.max(),
        }
    )


def _by(
    frames: pd.DataFrame,
    keys: list[str],
    numbers: Callable[[pd.DataFrame], pd.Series] = _of_frames,
) -> pd.DataFrame:
    return pd.DataFrame(frames.groupby(keys, sort=False)[[*frames]].apply(numbers))


def _drawn(rng: np.random.Generator, alone_every: int = 0, **what: Any) -> pd.DataFrame:
    """The frames of one drawn stack; `twofold`: another distance has their radius, too."""
    with tempfile.TemporaryDirectory() as folder:
        stack = drawn_stack(Path(folder) / "stack", rng, **what)
        frames = frame_errors(stack, rng, alone_every=alone_every)
    if not alone_every:
        return frames
    first, world = stack.labels[0], World(Scene.model_validate(stack.description["scene"]))
    axis = np.array(first.axis)
    tips = np.array(first.spot_mm) - _SEARCHED_DISTANCES_MM[:, None] * axis
    distances = np.array([labels.d_mm for labels in stack.labels])
    twofold = share_a_radius(distances, _SEARCHED_DISTANCES_MM, half_maximum_px(world, tips, axis))
    return frames.assign(twofold=twofold)


def pixel_poses(full: bool = False) -> pd.DataFrame:
    """First frames, and those from the fifth on, which use what the earlier ones showed.

    One stack of twelve frames for each beam and wall (full: four).
    """
    rng = np.random.default_rng(20261123)
    frames = pd.concat(
        _drawn(rng, beam=beam, wall=wall, motion=motion, frames=12).assign(beam=beam, wall=wall)
        for motion in ("withdrawal", "hand", "withdrawal", "hand")[: 4 if full else 1]
        for beam in BEAMS
        for wall in WALLS
    )
    frames = frames.assign(of_stack=np.where(frames.frame == 0, "first", "5th on"))
    shown = frames[(frames.frame == 0) | (frames.frame >= 4)]
    return _by(shown, ["beam", "wall", "of_stack"])


_SEARCHED_DISTANCES_MM = np.arange(0.25, 9.0, 0.125)


def branches(full: bool = False) -> pd.DataFrame:
    """Distances whose radius another has too, over 0.3 to 6 mm on an even wall.

    Each fifth frame is read as a first one, because later ones follow a distance that is known. Ten
    stacks of twenty frames (full: a hundred).
    """
    rng, found = np.random.default_rng(20261125), []
    for number in range(100 if full else 10):
        beam, moves = ("dome, vitreous", "candidate, air")[number % 2], number // 2 % 2
        motion, end_mm = ("hand", 6.0) if moves else ("withdrawal", 6.0 - 20 * MM_PER_FRAME)
        what = {"beam": beam, "wall": "uniform", "motion": motion, "frames": 20}
        read = _drawn(rng, alone_every=5, between_mm=(0.3, end_mm), **what)
        first = np.where(read.frame % 5 == 0, "first", "later")
        found.append(read.assign(beam=beam, read_as=first))
    frames = pd.concat(found)

    def numbers(some: pd.DataFrame) -> pd.Series:
        # Nearer branches hardly differ in their radius.
        wrong = (some.distance_mm[some.posed].abs() > 0.1).sum()
        own = pd.Series({"twofold": some.twofold.sum(), "wrong_branch": wrong})
        return pd.concat([_of_frames(some), own])

    return _by(frames, ["beam", "read_as"], numbers)


def share_a_radius(distances: np.ndarray, grid: np.ndarray, radii: np.ndarray) -> np.ndarray:
    """Whether a curve of radii over a growing grid takes the value at a distance twice."""
    larger = radii > np.interp(distances, grid, radii)[:, None]
    crossings = np.count_nonzero(np.diff(larger, axis=1), axis=1)
    return np.asarray(crossings > 1)


def coverage(full: bool = False) -> pd.DataFrame:
    """Stated errors of single frames, one a stack: shares in the 68 % and 95 % regions.

    Ten stacks on each wall (full: 163).
    """
    found = []
    for number in range(163 if full else 10):
        beam, motion = [*BEAMS][number % 3], "hand" if number % 2 else "withdrawal"
        for k, wall in enumerate(WALLS):
            rng = np.random.default_rng([20261212, k, number])
            read = _drawn(rng, beam=beam, wall=wall, motion=motion, frames=1)
            found.append(read.assign(wall=wall))
    frames = pd.concat(found, ignore_index=True)
    posed = frames[frames.posed]
    inside = pd.DataFrame(
        {
            f"{name}_in_{100 * level:.0f}": posed[f"{name}_chi_squared"] < chi2.ppf(level, numbers)
            for name, numbers in (("d", 1), ("tip", 3), ("axis", 2), ("pose", 5))
            for level in (0.68, 0.95)
        }
    )
    return _by(frames, ["wall"]).join(inside.groupby(posed.wall).mean())


def memory(full: bool = False) -> pd.DataFrame:
    """A reader of one hand's motion, forwards and backwards without jumps (full: 10,000 frames)."""
    rng, number, distinct = np.random.default_rng(20261126), 10_000 if full else 300, 60
    warm = 2 * distinct - 2  # once forwards and backwards, while programs are compiled
    seconds, used_mb, posed = np.empty(warm + number), [], 0
    with tempfile.TemporaryDirectory() as folder:
        hand: dict[str, Any] = {"motion": "hand", "beam": "dome, vitreous", "wall": "photograph"}
        stack = drawn_stack(Path(folder) / "stack", rng, frames=distinct, **hand)
        frames = list(open_source(stack.folder))
        began = time.perf_counter()
        reader = informed_reader(stack)
        start_s = time.perf_counter() - began
        poses = noisy_poses(stack, rng)
    for k, frame in enumerate(islice(cycle(frames + frames[-2:0:-1]), warm + number)):
        began = time.perf_counter()
        read = reader.read(frame, poses=poses)
        seconds[k] = time.perf_counter() - began
        if k >= warm:
            posed += bool(read.range and read.range.poses)
            used_mb.append(memory_mb())
    row = {
        "with_a_pose": posed,
        "reader_starts_s": start_s,
        "first_frame_s": seconds[0],
        # Frames while the wall's texture is learnt, then later ones.
        "slow_while_learning": (seconds[1:warm] > 0.15).sum(),
        "median_ms": 1e3 * np.median(seconds[warm:]),
        "slowest_ms": 1e3 * seconds[warm:].max(),
        "start_mb": used_mb[0],
        "most_mb": max(used_mb),
    }
    return pd.DataFrame([row])
