"""Frames of a rendered stack, read in the mode pixels, and how far each is off.

The beam is known, as a calibration says it. The robot says the beam's axis with an error of 5
degrees, one draw a stack, and the tip's relative motion; nothing says the distance. The sub-pixel
and the literal mode measure the same frames.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

import optics
from benchmarks.sets.read import own_reader
from benchmarks.studies.pose import PRIOR_DEG, drawn_prior
from estimator.distance import RangeFlag, TipPose
from estimator.files import (
    Calibration,
    FrameLabels,
    Pose,
    PoseTrack,
    Stack,
    read_microscope,
    read_poses,
    write_calibration,
)
from estimator.run import Options, Reader, Reading
from estimator.sources import open_source
from scenes import Scene
from scenes.world import World


class FrameErrors(NamedTuple):
    """Errors of one frame; lengths in mm, angles in degrees, and NaN where there is no pose.

    `doubt` is of the pose, or says why there is none; `memory` is a `WallMemory`. `bound_mm` is the
    Cramér-Rao bound of the distance from the ellipse, where the scene asks for it. The squares of
    the Mahalanobis distances are of the pose's five numbers, of its tip and of its axis.
    `half_maximum_px` is the semi-minor axis of the half-maximum ellipse at the pose, `subpixel_px`
    and `literal_px` those that the two other modes measure, all less the true one.
    """

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
    literal_px: float
    doubt: str
    memory: str
    bound_mm: float
    seconds: float

    @property
    def posed(self) -> bool:
        """Whether there is a pose without a doubt."""
        return not math.isnan(self.distance_mm) and not self.doubt

    @property
    def found(self) -> bool:
        """Whether the sub-pixel mode measures the spot."""
        return not math.isnan(self.subpixel_px)


def frame_errors(
    stack: Stack,
    calibration: Calibration,
    rng: np.random.Generator,
    *,
    alone_every: int | None = None,
) -> Iterator[FrameErrors]:
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
        yield FrameErrors(
            frame=number,
            d_mm=labels.d_mm,
            **_errors_of_pose(pose, labels),
            distance_mm=read.distance_mm - labels.d_mm,
            sigma_mm=read.sigma_distance_mm,
            half_maximum_px=_half_maximum_error_px(world, pose, labels),
            subpixel_px=_semi_minor_error_px(subpixel.read(frame.image), labels),
            literal_px=_semi_minor_error_px(literal.read(frame.image), labels),
            doubt=doubt_of_pose(read),
            memory=read.range.wall.value if read.range else "",
            bound_mm=labels.bound_d_mm,
            seconds=seconds,
        )


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
