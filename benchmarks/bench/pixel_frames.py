"""Rendered stacks of a drawn scene, read in the mode pixels, and how far each frame is off.

The beam is known. The robot says the beam's axis with an error of 5 degrees, one draw a stack, and
the tip's relative motion; nothing says the distance. Each wall, beam and motion is drawn anew from
a seed: place, tilt, texture and noise.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import optics
from benchmarks.studies.pose import PRIOR_DEG, drawn_prior
from estimator.distance import TipPose
from estimator.files import (
    Calibration,
    Pose,
    PoseTrack,
    Stack,
    read_poses,
    write_calibration,
)
from estimator.run import Options, Reader
from estimator.sources import open_source
from scenes import Scene, SceneError, render_stack
from scenes.world import World

BEAMS: dict[str, dict[str, Any]] = {
    "cone": {"kind": "cone"},
    "dome, vitreous": {"kind": "lens", "lens": "dome", "medium": "vitreous"},
    "candidate, air": {"kind": "lens", "lens": "paper-candidate", "medium": "air"},
}
WALLS = ("uniform", "printed paper", "retina", "photograph")
_FIELD_MM = 2.2  # half of the photograph's width, where every wall has a picture
_SURE = 1e-6  # relative error of a beam that is known
_FRAMES = 12  # over which the withdrawal goes 2 mm
_TRIES = 50  # draws of a scene until its spot lies in the window


@dataclass(frozen=True)
class Circumstances:
    """What a stack is of.

    Attributes:
        beam: one of `BEAMS`.
        wall: one of `WALLS`.
        motion: "withdrawal" or "hand".
        frames: number of frames.
        tables: what else the scene has, by table.
        sigmas: relative errors of the beam's own parameters, by name.
    """

    beam: str
    wall: str
    motion: str
    frames: int
    tables: dict[str, dict[str, Any]] = field(default_factory=dict)
    sigmas: dict[str, float] = field(default_factory=dict)


class Reading(NamedTuple):
    """Errors of one frame; lengths in mm, angles in degrees, and NaN where there is no pose.

    `wall` is of the scene, `memory` a `WallMemory`, and `bound_mm` the Cramér-Rao bound of the
    distance from the ellipse, where the scene asks for it. The squares of the Mahalanobis distances
    are of the pose's five numbers, of its tip and of its axis. `half_maximum_px` is the semi-minor
    axis of the half-maximum ellipse at the pose, and `subpixel_px` the one that the sub-pixel mode
    measures, both less the true one.
    """

    beam: str
    wall: str
    motion: str
    frame: int
    d_mm: float
    distance_mm: float
    sigma_mm: float
    tip_mm: float
    axis_deg: float
    sigma_axis_deg: float
    chi_squared: float
    tip_chi_squared: float
    axis_chi_squared: float
    half_maximum_px: float
    subpixel_px: float
    found: bool
    doubt: str
    memory: str
    bound_mm: float
    seconds: float

    @property
    def posed(self) -> bool:
        """Whether there is a pose without a doubt."""
        return not math.isnan(self.distance_mm) and not self.doubt


def readings_of(what: Circumstances, rng: np.random.Generator, folder: Path) -> Iterator[Reading]:
    """Render a drawn stack into a folder and read its frames.

    Raises:
        SceneError: no drawn scene is possible.
    """
    stack, world = _rendered(what, rng, folder)
    reader, poses = _reader(stack, what, rng)
    for frame, labels in zip(open_source(stack.folder), stack.labels, strict=True):
        began = time.perf_counter()
        read = reader.read(
            frame.image, time_s=frame.time_s, exposure_s=frame.exposure_s, poses=poses
        )
        seconds = time.perf_counter() - began
        off, covariance = np.full(5, math.nan), np.eye(5)
        distance = sigma = subpixel = half = math.nan
        whole = of_tip = of_axis = math.nan
        if read.result:
            subpixel = read.result.semi_minor_px - labels.half_max_semi_minor_px
        if read.range and read.range.poses:
            pose = read.range.poses[0]
            assert pose.covariance is not None
            off, covariance = pose.less(labels.tip_mm, labels.axis), pose.covariance
            whole, of_tip, of_axis = (
                pose.chi_squared(labels.tip_mm, labels.axis, part=part)
                for part in (slice(None), slice(3), slice(3, None))
            )
            distance, sigma = read.range.distance_mm - labels.d_mm, read.range.sigma_mm
            half = _half_maximum_px(world, pose) - labels.half_max_semi_minor_px
        yield Reading(
            beam=what.beam,
            wall=what.wall,
            motion=what.motion,
            frame=frame.index,
            d_mm=labels.d_mm,
            distance_mm=distance,
            sigma_mm=sigma,
            tip_mm=float(np.linalg.norm(off[:3])),
            axis_deg=math.degrees(np.linalg.norm(off[3:])),
            sigma_axis_deg=math.degrees(math.sqrt(covariance[3, 3] + covariance[4, 4])),
            chi_squared=whole,
            tip_chi_squared=of_tip,
            axis_chi_squared=of_axis,
            half_maximum_px=half,
            subpixel_px=subpixel,
            found=bool(read.result),
            doubt=read.doubt,
            memory=read.range.wall.value if read.range else "",
            bound_mm=labels.bound_d_mm,
            seconds=seconds,
        )


def _half_maximum_px(world: World, pose: TipPose) -> float:
    """Semi-minor axis of the half-maximum ellipse that the true beam would have at a pose."""
    truth = optics.spot_truth(
        world.wall,
        world.microscope,
        world.table,
        tip=pose.tip_mm[None],
        axis=pose.axis[None],
        half_angle=world.cone.half_angle,
        apex_offset=world.cone.apex_offset,
    )
    return float(truth.half_max.semi_minor[0])


def _rendered(what: Circumstances, rng: np.random.Generator, folder: Path) -> tuple[Stack, World]:
    for _ in range(_TRIES):
        seed = int(rng.integers(1, 2**31))
        scene = Scene.model_validate(_scene(what, seed, rng))
        try:
            return render_stack(scene, folder), World(scene)
        except SceneError as error:  # the drawn spot leaves the window
            refused = error
    raise refused


def _scene(what: Circumstances, seed: int, rng: np.random.Generator) -> dict[str, Any]:
    distance = float(rng.uniform(1.0, 3.5))
    moves = {
        "withdrawal": {
            "start_mm": distance,
            "travel_mm": 2.0 * what.frames / _FRAMES,
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


def _reader(
    stack: Stack, what: Circumstances, rng: np.random.Generator
) -> tuple[Reader, PoseTrack]:
    """A reader with the true beam, and the robot's poses with an error of the axis."""
    calibration, stated = stack.folder / "beam.json", stack.folder / "stated.toml"
    write_calibration(calibration, _calibration(what, rng))
    still = "shake_px" not in what.tables.get("unrest", {})
    shake = "shake_px = 0.0\n" if still else ""  # of one that shakes nothing is known
    stated.write_text(f"axis_sigma_deg = {PRIOR_DEG}\n{shake}")
    reader = Options.of(
        {
            "mode": "pixels",
            "calibration": calibration,
            "microscope": stack.folder / "microscope.json",
            "eye_from_robot": (0.0, 0.0, 0.0, 1.0),
            "stated": stated,
        }
    ).reader()
    axis = np.array(stack.labels[0].axis)
    turn = drawn_prior(axis, rng) - axis
    told = [
        Pose.along(
            _unit(np.array(pose.axis) + turn), time_s=pose.time_s, position_mm=pose.position_mm
        )
        for pose in read_poses(stack.folder / "kinematics.csv")
    ]
    return reader, PoseTrack(told)


def _unit(vector: np.ndarray) -> tuple[float, float, float]:
    x, y, z = (vector / np.linalg.norm(vector)).tolist()
    return x, y, z


def _calibration(what: Circumstances, rng: np.random.Generator) -> Calibration:
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
