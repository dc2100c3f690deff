"""Frames of a rendered stack, read in the mode pixels, and how far each is off.

The beam is known, as a calibration says it. The robot says the beam's axis with an error of 5
degrees, one draw a stack, and the tip's relative motion; nothing says the distance. The sub-pixel
and the literal mode measure the same frames.

Stacks are drawn anew from a seed: wall, beam, motion, place, tilt, texture and noise.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

import optics
from benchmarks.paper import rms
from benchmarks.sets.read.stacks import own_reader
from benchmarks.studies.pose import PRIOR_DEG, drawn_prior
from estimator.distance import RangeFlag, TipPose
from estimator.files import (
    Calibration,
    FrameLabels,
    Pose,
    PoseTrack,
    Stack,
    cache_file,
    read_microscope,
    read_poses,
    write_calibration,
)
from estimator.run import Options, Reader, Reading
from estimator.sources import open_source
from scenes import Scene, SceneError, load_mitsuba, render_stack
from scenes.world import World

Row = dict[str, Any]
"""Errors of one frame; lengths in mm, angles in degrees, and NaN where there is no pose.

`doubt` is of the pose, or says why there is none; `memory` is a `WallMemory`. `bound_mm` is the
Cramér-Rao bound of the distance from the ellipse, where the scene asks for it. The squares of the
Mahalanobis distances are of the pose's five numbers, of its tip and of its axis. `half_maximum_px`
is the semi-minor axis of the half-maximum ellipse at the pose, `subpixel_px` and `literal_px` those
that the two other modes measure, all less the true one.
"""


def as_table(rows: Iterable[Row]) -> pd.DataFrame:
    """Frames with `posed`, a pose without a doubt, and `found`, a spot in the sub-pixel mode."""
    frames = pd.DataFrame(list(rows))
    posed = frames.distance_mm.notna() & (frames.doubt == "")
    return frames.assign(posed=posed, found=frames.subpixel_px.notna())


def sizes(frames: pd.DataFrame) -> dict[str, str]:
    """Cells of a table: errors of the frames with a pose, RMS, and what the mode stated."""
    posed = frames[frames.posed]
    median = f"{1e3 * posed.distance_mm.abs().median():.1f}"
    return {
        "d RMS, µm": f"{1e3 * rms(posed.distance_mm):.1f}",
        "median": median,
        "stated": f"{1e3 * rms(posed.sigma_mm):.1f}",
        "tip, µm": f"{1e3 * rms(posed.tip_mm):.1f}",
        "axis, °": f"{rms(posed.axis_deg):.3f}",
        "chi²_5 / 5": f"{posed.chi_squared.mean() / 5:.2f}",
    }


def frame_errors(
    stack: Stack,
    calibration: Calibration,
    rng: np.random.Generator,
    *,
    alone_every: int | None = None,
) -> Iterator[Row]:
    """Read the frames of a stack in their order.

    Args:
        rng: draws the error of the axis.
        alone_every: the first of each so many frames is read as if nothing came before it; None:
            only the stack's first.

    Raises:
        InputError: the mode pixels cannot read the stack; the text says why.
    """
    world = World(Scene.model_validate(stack.description["scene"]))
    microscope = read_microscope(stack.folder / "microscope.json")
    reader, poses = robot_reader(stack, calibration), told_poses(stack, rng)
    start = stack.labels[0].half_max_x_px, stack.labels[0].half_max_y_px
    subpixel, literal = (own_reader(m, microscope, click=start) for m in ("subpixel", "literal"))
    for number, (frame, labels) in enumerate(
        zip(open_source(stack.folder), stack.labels, strict=True)
    ):
        if alone_every is not None and number % alone_every == 0:
            reader.forget()
            subpixel.forget()
            literal.look_at(labels.half_max_x_px, labels.half_max_y_px)
        began = time.perf_counter()
        read = reader.read(
            frame.image, time_s=frame.time_s, exposure_s=frame.exposure_s, poses=poses
        )
        seconds = time.perf_counter() - began
        pose = read.range.poses[0] if read.range and read.range.poses else None
        yield {
            "frame": number,
            "d_mm": labels.d_mm,
            "distance_mm": read.distance_mm - labels.d_mm,
            "sigma_mm": read.sigma_distance_mm,
            **_errors_of_pose(pose, labels),
            "half_maximum_px": _half_maximum_error_px(world, pose, labels),
            "subpixel_px": _semi_minor_error_px(subpixel.read(frame.image), labels),
            "literal_px": _semi_minor_error_px(literal.read(frame.image), labels),
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
    return PoseTrack(
        [
            Pose.along(
                _unit(np.array(pose.axis) + turn), time_s=pose.time_s, position_mm=pose.position_mm
            )
            for pose in read_poses(stack.folder / "kinematics.csv")
        ]
    )


def doubt_of_pose(read: Reading) -> str:
    """Why the pose is doubtful or missing; empty if all is well, even where there is no spot."""
    if read.range is None:
        return read.doubt
    return "" if read.range.flag is RangeFlag.NONE else read.range.flag.value


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


def _semi_minor_error_px(read: Reading, labels: FrameLabels) -> float:
    if not read.result:
        return math.nan
    return read.result.semi_minor_px - labels.half_max_semi_minor_px


def _half_maximum_error_px(world: World, pose: TipPose | None, labels: FrameLabels) -> float:
    """Error of the semi-minor axis that the true beam's half-maximum ellipse has at a pose."""
    if pose is None:
        return math.nan
    (semi_minor,) = half_maximum_px(world, pose.tip_mm[None], pose.axis)
    return float(semi_minor) - labels.half_max_semi_minor_px


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


def _unit(vector: np.ndarray) -> tuple[float, float, float]:
    x, y, z = (vector / np.linalg.norm(vector)).tolist()
    return x, y, z


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


def drawn_errors(what: Circumstances, rng: np.random.Generator, folder: Path) -> Iterator[Row]:
    """Render a drawn stack into a folder and read its frames.

    Raises:
        SceneError: no drawn scene is possible.
    """
    stack = drawn_stack(what, rng, folder)
    yield from frame_errors(stack, drawn_calibration(what, rng), rng)


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
        software="benchmarks.bench.pixel_frames",
    )
