"""The mode pixels on drawn stacks: errors, stated errors, adverse conditions, memory.

The beam is known, as a calibration says it. The robot says the beam's axis with an error of 5
degrees, one draw a stack, and the tip's relative motion; nothing says the distance. The sub-pixel
mode measures the same frames.

Stacks are drawn anew from a seed: wall, beam, motion, place, tilt, texture and noise.
"""

from __future__ import annotations

import math
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from itertools import cycle, islice
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from scipy.stats import chi2

import optics
from benchmarks.bench import tracks
from benchmarks.bench.load import memory_mb
from benchmarks.paper import largest, rms
from benchmarks.sets.read import own_reader, true_beam
from benchmarks.sets.spec import SetSpec, load_spec, plan
from benchmarks.studies.pose import PRIOR_DEG, drawn_prior
from estimator.distance.range import TipPose
from estimator.run.options import Options
from estimator.run.reader import Reader, Reading
from estimator.sources.opening import open_source
from formats.calibration import Calibration, write_calibration
from formats.microscope import read_microscope
from formats.poses import Pose, PoseTrack, read_poses
from formats.stack import FrameLabels, Stack
from formats.whole_files import cache_file
from scenes import Scene, SceneError, load_mitsuba, render_stack
from scenes.world.world import World

Row = dict[str, Any]
"""Errors of one frame; lengths in mm, angles in degrees, and NaN where there is no pose.

`doubt` is of the pose, or says why there is none; `memory` is a `WallMemory`. `bound_mm` is the
Cramér-Rao bound of the distance from the ellipse, where the scene asks for it. The squares of the
Mahalanobis distances are of the pose's five numbers, of its tip and of its axis. `half_maximum_px`
is the semi-minor axis of the half-maximum ellipse at the pose, `subpixel_px` the one that sub-pixel
mode measures, both less the true one.
"""


def as_table(rows: Iterable[Row]) -> pd.DataFrame:
    """Frames with `posed`, a pose without a doubt, and `found`, a spot in the sub-pixel mode."""
    frames = pd.DataFrame(list(rows))
    return frames.assign(
        posed=frames.distance_mm.notna() & (frames.doubt == ""),
        found=frames.subpixel_px.notna(),
        d_chi_squared=(frames.distance_mm / frames.sigma_mm) ** 2,
        pose_chi_squared=frames.chi_squared,
    )


def frame_errors(
    stack: Stack,
    calibration: Calibration,
    rng: np.random.Generator,
    *,
    alone_every: int | None = None,
) -> Iterator[Row]:
    """Read the frames of a stack in their order.

    Args:
        alone_every: the first of each so many frames is read as if nothing came before it; None:
            only the stack's first.

    Raises:
        InputError: the mode pixels cannot read the stack; the text says why.
    """
    world = World(Scene.model_validate(stack.description["scene"]))
    microscope = read_microscope(stack.folder / "microscope.json")
    reader, poses = robot_reader(stack, calibration), told_poses(stack, rng)
    start = stack.labels[0].half_max_x_px, stack.labels[0].half_max_y_px
    subpixel = own_reader("subpixel", microscope, click=start)
    for number, (frame, labels) in enumerate(
        zip(open_source(stack.folder), stack.labels, strict=True)
    ):
        if alone_every is not None and number % alone_every == 0:
            reader.forget()
            subpixel.forget()
        began = time.perf_counter()
        read = reader.read(
            frame.image, time_s=frame.time_s, exposure_s=frame.exposure_s, poses=poses
        )
        seconds = time.perf_counter() - began
        pose = read.range.poses[0] if read.range and read.range.poses else None
        spot, true_px = subpixel.read(frame.image).result, labels.half_max_semi_minor_px
        at_pose = math.nan  # error of the semi-minor axis that the true beam has at the pose
        if pose is not None:
            at_pose = float(half_maximum_px(world, pose.tip_mm[None], pose.axis)[0]) - true_px
        yield {
            "frame": number,
            "d_mm": labels.d_mm,
            "distance_mm": read.distance_mm - labels.d_mm,
            "sigma_mm": read.sigma_distance_mm,
            **_errors_of_pose(pose, labels),
            "half_maximum_px": at_pose,
            "subpixel_px": spot.semi_minor_px - true_px if spot else math.nan,
            "doubt": doubt_of_pose(read),
            "memory": read.range.wall.value if read.range else "",
            "bound_mm": labels.bound_d_mm,
            "seconds": seconds,
        }


def robot_reader(stack: Stack, calibration: Calibration) -> Reader:
    """A reader that knows the beam, how well the robot says the axis, and how the view shakes."""
    beam, stated = stack.folder / "beam.json", stack.folder / "stated.toml"
    write_calibration(beam, calibration)
    shake_px = stack.described("scene.unrest.shake_px", float)
    stated.write_text(f"axis_sigma_deg = {PRIOR_DEG}\nshake_px = {shake_px}\n")
    return Options.of(
        {
            "mode": "pixels",
            "calibration": beam,
            "microscope": stack.folder / "microscope.json",
            "eye_from_robot": (0.0, 0.0, 0.0, 1.0),
            "stated": stated,
        }
    ).reader()


def told_poses(stack: Stack, rng: np.random.Generator) -> PoseTrack:
    """The robot's poses of a stack, all with one drawn error of the axis."""
    axis = np.array(stack.labels[0].axis)
    turn = drawn_prior(axis, rng) - axis
    told = []
    for pose in read_poses(stack.folder / "kinematics.csv"):
        turned = np.array(pose.axis) + turn
        x, y, z = (turned / np.linalg.norm(turned)).tolist()
        told.append(Pose.along((x, y, z), time_s=pose.time_s, position_mm=pose.position_mm))
    return PoseTrack(told)


def doubt_of_pose(read: Reading) -> str:
    """Why the pose is doubtful or missing; empty if all is well, even where there is no spot."""
    if read.range is None:
        return read.doubt
    return read.range.flag.value if read.range.flag else ""


def _errors_of_pose(pose: TipPose | None, labels: FrameLabels) -> dict[str, float]:
    names = "tip_mm", "axis_deg", "sigma_axis_deg"
    squares = {
        "chi_squared": slice(None),
        "tip_chi_squared": slice(3),
        "axis_chi_squared": slice(3, None),
    }
    if pose is None:
        return dict.fromkeys((*names, *squares), math.nan)
    assert pose.covariance is not None
    off = pose.less(labels.tip_mm, labels.axis)
    sigma = math.sqrt(pose.covariance[3, 3] + pose.covariance[4, 4])
    errors = float(np.linalg.norm(off[:3])), math.degrees(np.linalg.norm(off[3:]))
    return dict(zip(names, (*errors, math.degrees(sigma)), strict=True)) | {
        name: pose.chi_squared(labels.tip_mm, labels.axis, part=part)
        for name, part in squares.items()
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
MM_PER_FRAME = 2.0 / 12
"""Of a withdrawal."""

_FIELD_MM = 2.2  # half of the photograph's width, where every wall has a picture
_SURE = 1e-6  # relative error of a beam that is known
_TRIES = 50  # draws of a scene until its spot lies in the window


@dataclass(frozen=True)
class Circumstances:
    """What a stack is of.

    Attributes:
        beam: one of `BEAMS`.
        wall: one of `WALLS`.
        motion: "withdrawal" or "hand".
        tables: what else the scene has, by table.
        sigmas: relative errors of the beam's own parameters, by name.
        between_mm: least and largest first distance of a withdrawal, or mean distance of a hand.
    """

    beam: str
    wall: str
    motion: str
    frames: int
    tables: dict[str, dict[str, Any]] = field(default_factory=dict)
    sigmas: dict[str, float] = field(default_factory=dict)
    between_mm: tuple[float, float] = (1.0, 3.5)


def prepare() -> None:
    """Load Mitsuba, and let JAX keep what it compiles, as `eyespot` does: that takes minutes."""
    import jax

    jax.config.update("jax_compilation_cache_dir", str(cache_file("jax", "").parent))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.1)
    load_mitsuba()


def drawn_stack(what: Circumstances, rng: np.random.Generator, folder: Path) -> Stack:
    """Draw scenes until one is possible, and render it into a folder.

    Raises:
        SceneError: no drawn scene is possible.
    """
    for _ in range(_TRIES):
        seed = int(rng.integers(1, 2**31))
        scene = Scene.model_validate(_scene(what, seed, rng))
        try:
            return render_stack(scene, folder)
        except SceneError as error:  # the drawn spot leaves the window
            refused = error
    raise refused


def _scene(what: Circumstances, seed: int, rng: np.random.Generator) -> dict[str, Any]:
    distance = float(rng.uniform(*what.between_mm))
    moves = {
        "withdrawal": {
            "start_mm": distance,
            "travel_mm": MM_PER_FRAME * what.frames,
            "frames": what.frames,
            "speed_mm_s": 1.0,
        },
        "hand": {
            "kind": "hand",
            "distance_mm": distance,
            "duration_s": 0.1 * what.frames - 0.05,  # in the middle between frames
            "top_speed_mm_s": 2.0,
            "seed": seed,
        },
    }
    tables: dict[str, Any] = {
        "schema": 1,
        "seed": seed,
        "phantom": {"wall": what.wall, "texture_seed": seed},
        "instrument": {"visible": False},
        "source": BEAMS[what.beam],
        "spot": {
            "eccentricity_mm": float(rng.uniform(0, _FIELD_MM)),
            "azimuth_deg": float(rng.uniform(60, 120)),
            "incidence_deg": float(rng.uniform(10, 30)),
            "incidence_azimuth_deg": float(rng.uniform(0, 360)),
        },
        "motion": moves[what.motion],
        "exposures": {"kinds": ["metered"]},
    }
    for name, table in what.tables.items():
        tables[name] = tables.get(name, {}) | table
    return tables


def drawn_calibration(what: Circumstances, rng: np.random.Generator) -> Calibration:
    """A calibration of a beam; parameters with an error in `sigmas` are off by one."""
    source = BEAMS[what.beam]
    medium = source.get("medium", "air")
    if source["kind"] == "cone":
        model, values = "planar", {"k": 20.0, "b": -5.117}
    else:
        lens = optics.load_lens(source["lens"])
        model = "lens"
        values = {name: float(x) for name, x in vars(lens).items() if x is not None}
    sigmas = [what.sigmas.get(name, _SURE) * abs(value) for name, value in values.items()]
    values = {
        name: value + sigma * rng.standard_normal() if name in what.sigmas else value
        for (name, value), sigma in zip(values.items(), sigmas, strict=True)
    }
    if model == "lens":  # the drawn cap may not reach below the core
        values["glue_length"] = max(values["glue_length"], values["sag"])
    return Calibration(
        model=model,
        values=values,
        covariance=np.diag(np.square(sigmas)),
        medium=medium,
        medium_index=optics.MEDIA[medium],
        fitted_on="the beam that was rendered",
        data_sha256="0" * 64,
        software="benchmarks.bench.pixels",
    )


# The benchmarks.

_WRONG = 1e-4
"""Over the number of frames: probability of a chi squared that no honest pose has."""


def _of_posed(summary: Callable[[pd.DataFrame], float]) -> Callable[..., float]:
    """A number of a row's frames with a pose."""
    return lambda read, *row: float(summary(read.posed(*row)))


@tracks(
    frames=lambda read, *row: len(read.select(*row)),
    with_a_pose=lambda read, *row: len(read.posed(*row)),
    subpixel_found=lambda read, *row: int(read.select(*row).found.sum()),
    # Poses whose chi squared no honest estimator has in so many frames.
    silently_wrong=lambda read, frames, *which: int(
        (read.posed(frames, *which).chi_squared > chi2.isf(_WRONG / len(frames), 5)).sum()
    ),
    median_ms=lambda read, *row: float(1e3 * read.select(*row).seconds.median()),
    d_um=_of_posed(lambda posed: 1e3 * rms(posed.distance_mm)),
    d_stated_um=_of_posed(lambda posed: 1e3 * rms(posed.sigma_mm)),
    d_largest_um=_of_posed(lambda posed: 1e3 * largest(posed.distance_mm)),
    tip_um=_of_posed(lambda posed: 1e3 * rms(posed.tip_mm)),
    axis_deg=_of_posed(lambda posed: rms(posed.axis_deg)),
    axis_stated_deg=_of_posed(lambda posed: rms(posed.sigma_axis_deg)),
    # Semi-minor axes: of the half-maximum ellipse at the pose, and as sub-pixel mode measures it.
    half_maximum_px=_of_posed(lambda posed: rms(posed.half_maximum_px)),
    subpixel_px=_of_posed(lambda posed: rms(posed.subpixel_px)),
    chi_squared_over_5=_of_posed(lambda posed: posed.chi_squared.mean() / 5),
    largest_chi_squared=_of_posed(lambda posed: posed.chi_squared.max()),
)
class _Read:
    """What selected frames show; errors are RMS over the frames with a pose without a doubt."""

    full = False

    def select(self, frames: pd.DataFrame, *which: Any) -> pd.DataFrame:
        """The frames of a row of the table: those whose columns have these values."""
        for name, value in zip(self.param_names, which, strict=True):  # type: ignore[attr-defined]
            frames = frames[(frames[name] == value) | (value == "all")]
        return frames

    def posed(self, *row: Any) -> pd.DataFrame:
        """Those of them with a pose."""
        some = self.select(*row)
        return some[some.posed]


def _drawn(rows: Iterable[tuple[dict[str, Any], Circumstances]], rng: Any) -> pd.DataFrame:
    """The frames of drawn stacks; `rng` is one generator, or makes one from a row's columns."""
    frames: list[Row] = []
    with tempfile.TemporaryDirectory() as folder:
        for columns, what in rows:
            own = rng(columns) if callable(rng) else rng
            place = Path(folder) / f"{len(frames)}"
            stack = drawn_stack(what, own, place)
            read = frame_errors(stack, drawn_calibration(what, own), own)
            frames += [columns | frame for frame in read]
    return as_table(frames)


# The bound is Cramér and Rao's, for the distance from the ellipse on a known wall.
@tracks(bound_um=_of_posed(lambda posed: 1e3 * rms(posed.bound_mm)))
class PixelPoses(_Read):
    """First frames, and those from the fifth on, which use what the earlier ones showed."""

    params = ([*BEAMS], [*WALLS], ["first", "5th on"])
    param_names = ("beam", "wall", "of_stack")

    def setup_cache(self) -> pd.DataFrame:
        """One stack of twelve frames for each beam and wall (full: four)."""
        prepare()
        rows = [
            (
                {"beam": beam, "wall": wall},
                # The bound takes the wall as known, so that it is one on an even wall only.
                Circumstances(beam, wall, motion, 12, _BOUND if wall == "uniform" else {}),
            )
            for motion in ("withdrawal", "hand", "withdrawal", "hand")[: 4 if self.full else 1]
            for beam in BEAMS
            for wall in WALLS
        ]
        frames = _drawn(rows, np.random.default_rng(20261123))
        place = np.select([frames.frame == 0, frames.frame >= 4], ["first", "5th on"], "between")
        return frames.assign(of_stack=place)


_BOUND = {"exposures": {"kinds": ["metered"], "bound": True}}

_ADVERSE: dict[str, dict[str, Any]] = {
    "as it should be": {},
    "lens known to 0.5 %": {"sigmas": {"numerical_aperture": 0.005, "sag": 0.005}},
    # The tip is known to 0.5 % of its distance from the apex, 5 mm behind it: 40 um.
    "cone known to 0.5 %": {"sigmas": {"k": 0.005, "b": 0.005}},
    "shake 1 px, power 5 %": {"unrest": {"shake_px": 1.0, "power_swing": 0.05}},
    "eye turns, 5°/s": {"unrest": {"rotation_deg_s": (4.0, 3.0, 0.0)}},
    "microscope drifts, 0.7 mm/s": {"unrest": {"drift_mm_s": (0.6, 0.3)}},
    "wet wall": {"phantom": {"coat": "wet"}},
    "defocus, 0.5 mm at NA 0.05": {
        "microscope": {"numerical_aperture": 0.05, "focus_mm": 0.5, "samples": 64}
    },
    "Bayer": {"camera": {"bayer": "RGGB"}},
    "JPEG 90": {"camera": {"jpeg_quality": 90}},
    "instrument in view": {"instrument": {"visible": True}},
    "a second tool": {"second_tool": {"visible": True}},
}
"""Changes of the scene's tables, and relative errors of the beam that the mode is told."""


class AdversePixels(_Read):
    """Beams, walls and cameras that are not as the mode believes; two beams on two walls."""

    params = ([*_ADVERSE],)
    param_names = ("circumstance",)

    def setup_cache(self) -> pd.DataFrame:
        """Stacks of eight frames (full: three times as many), the same draws for each row."""
        prepare()
        tables = []
        for name, changes in _ADVERSE.items():
            sigmas = changes.get("sigmas", {})
            scene = {key: table for key, table in changes.items() if key != "sigmas"}
            beams = [
                b
                for b in ("cone", "dome, vitreous")
                if not sigmas or (b[0] == "c") == ("k" in sigmas)
            ]
            rows = [
                (
                    {"circumstance": name},
                    Circumstances(
                        beam,
                        wall,
                        "hand" if number % 2 else "withdrawal",
                        8,
                        {
                            k: t | ({"wall": wall} if k == "phantom" else {})
                            for k, t in scene.items()
                        },
                        sigmas,
                    ),
                )
                for number in range(3 if self.full else 1)
                for beam in beams
                for wall in ("printed paper", "retina")
            ]
            tables.append(_drawn(rows, np.random.default_rng(7)))
        return pd.concat(tables, ignore_index=True)


_COMPARED_MM = np.arange(0.25, 9.0, 0.125)  # distances that the mode looks at


@tracks(
    twofold=lambda read, *row: int(read.select(*row).twofold.sum()),
    # Nearer branches hardly differ in their radius.
    wrong_branch=_of_posed(lambda posed: (posed.distance_mm.abs() > 0.1).sum()),
)
class Branches(_Read):
    """Distances whose radius another has too, over 0.3 to 6 mm on an even wall.

    Each fifth frame is read as a first one, because later ones follow a distance that is known.
    """

    params = (["dome, vitreous", "candidate, air"], ["first", "later"])
    param_names = ("beam", "read_as")

    def setup_cache(self) -> pd.DataFrame:
        """Ten stacks of twenty frames (full: a hundred)."""
        prepare()
        rng, rows = np.random.default_rng(20261125), []
        between = {"withdrawal": (0.3, 6.0 - 20 * MM_PER_FRAME), "hand": (0.3, 6.0)}
        with tempfile.TemporaryDirectory() as folder:
            for number in range(100 if self.full else 10):
                beam = self.params[0][number % 2]
                motion = "hand" if number // 2 % 2 else "withdrawal"
                what = Circumstances(beam, "uniform", motion, 20, between_mm=between[motion])
                stack = drawn_stack(what, rng, Path(folder) / f"{number}")
                told = drawn_calibration(what, rng)
                read = as_table(frame_errors(stack, told, rng, alone_every=5))
                first = np.where(read.frame % 5 == 0, "first", "later")
                rows.append(read.assign(beam=beam, twofold=_twofold(stack), read_as=first))
        return pd.concat(rows, ignore_index=True)


def _twofold(stack: Stack) -> list[bool]:
    """Of each frame, whether another distance has its radius, too, where the first spot is."""
    first, world = stack.labels[0], World(Scene.model_validate(stack.description["scene"]))
    axis = np.array(first.axis)
    tips = np.array(first.spot_mm) - _COMPARED_MM[:, None] * axis
    radii = half_maximum_px(world, tips, axis)
    distances = np.array([labels.d_mm for labels in stack.labels])
    return share_a_radius(distances, _COMPARED_MM, radii).tolist()


def share_a_radius(distances: np.ndarray, grid: np.ndarray, radii: np.ndarray) -> np.ndarray:
    """Whether a curve of radii over a growing grid takes the value at a distance twice."""
    larger = radii > np.interp(distances, grid, radii)[:, None]
    crossings = np.count_nonzero(np.diff(larger, axis=1), axis=1)
    return np.asarray(crossings > 1)


def _inside(square: str, numbers: int, level: float) -> Callable[..., float]:
    """Share of squares of Mahalanobis distances in the region of a level."""
    return _of_posed(lambda posed: (posed[square] < chi2.ppf(level, numbers)).mean())


@tracks(
    **{
        f"{name}_in_{100 * level:.0f}": _inside(f"{name}_chi_squared", numbers, level)
        for name, numbers in (("d", 1), ("tip", 3), ("axis", 2), ("pose", 5))
        for level in (0.68, 0.95)
    }
)
class Coverage(_Read):
    """Stated errors of single frames, one a stack: shares in the 68 % and 95 % regions."""

    params = ([*WALLS],)
    param_names = ("wall",)

    def setup_cache(self) -> pd.DataFrame:
        """Ten stacks on each wall (full: 163)."""
        prepare()
        rows = []
        for number in range(163 if self.full else 10):
            beam, motion = list(BEAMS)[number % 3], "hand" if number % 2 else "withdrawal"
            for wall in WALLS:
                columns = {"wall": wall, "number": number}
                rows.append((columns, Circumstances(beam, wall, motion, 1)))
        return _drawn(
            rows,
            lambda of: np.random.default_rng([20261212, WALLS.index(of["wall"]), of["number"]]),
        )


_CONDITIONS = "occlusion shadow glints saturation blur defocus clipped unrest spread camera".split()


def _missed(read: _Read, *row: Any) -> pd.DataFrame:
    """Frames that sub-pixel mode misses though their ellipse would tell d to 50 um."""
    some = read.select(*row)
    return some[~some.found & (some.bound_mm < 0.05)]


@tracks(
    missed_though_well_bound=lambda read, *row: len(_missed(read, *row)),
    of_those_with_a_pose=lambda read, *row: int(_missed(read, *row).posed.sum()),
)
class AdverseSet(_Read):
    """The stacks of the set adverse-v2 with a seed of its own; the mode knows each true beam."""

    params = ([*_CONDITIONS, "unseen", "all"],)
    param_names = ("condition",)

    def setup_cache(self) -> pd.DataFrame:
        """One stack a condition (full: three)."""
        prepare()
        spec = load_spec("adverse-v2").model_dump(by_alias=True)
        for split in ("adverse", "unseen"):
            spec[split]["stacks"] = 3 if self.full else 1
        tables = []
        for planned in plan(SetSpec.model_validate(spec | {"seed": 20261211})):
            rng = np.random.default_rng([20261211, planned.scene.seed])
            with tempfile.TemporaryDirectory() as folder:
                stack = render_stack(planned.scene, Path(folder) / planned.name)
                read = as_table(frame_errors(stack, true_beam(stack), rng))
            tables.append(read.assign(condition=planned.condition or planned.split))
        return pd.concat(tables, ignore_index=True)


@tracks(
    with_a_pose=lambda memory: memory.with_pose,
    reader_starts_s=lambda memory: memory.start,
    first_frame_s=lambda memory: float(memory.seconds[0]),
    # Frames while the wall's texture is learnt, then later ones.
    slow_while_learning=lambda memory: int((memory.seconds[1 : memory.warm] > 0.15).sum()),
    median_ms=lambda memory: float(1e3 * np.median(memory.seconds[memory.warm :])),
    slowest_ms=lambda memory: float(1e3 * memory.seconds[memory.warm :].max()),
    start_mb=lambda memory: memory.memory[0],
    most_mb=lambda memory: max(memory.memory),
)
class Memory:
    """A reader of one hand's motion, forwards and backwards without jumps (full: 10,000 frames)."""

    full = False
    distinct = 60
    warm = 2 * distinct - 2  # once forwards and backwards, while programs are compiled

    def setup(self) -> None:
        """Read."""
        prepare()
        what = Circumstances("dome, vitreous", "photograph", "hand", self.distinct)
        rng, number = np.random.default_rng(20261126), 10_000 if self.full else 300
        self.seconds, self.memory, self.with_pose = np.empty(self.warm + number), [], 0
        with tempfile.TemporaryDirectory() as folder:
            stack = drawn_stack(what, rng, Path(folder) / "stack")
            frames = list(open_source(stack.folder))
            began = time.perf_counter()
            reader = robot_reader(stack, drawn_calibration(what, rng))
            self.start = time.perf_counter() - began
            poses = told_poses(stack, rng)
        camera = islice(cycle(frames + frames[-2:0:-1]), self.warm + number)
        for k, frame in enumerate(camera):
            began = time.perf_counter()
            read = reader.read(
                frame.image, time_s=frame.time_s, exposure_s=frame.exposure_s, poses=poses
            )
            self.seconds[k] = time.perf_counter() - began
            if k >= self.warm:
                self.with_pose += bool(read.range and read.range.poses)
                self.memory.append(memory_mb())
