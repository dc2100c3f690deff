"""ROS bags: SPLIT/STACK/EXPOSURE.bag (ROS 1) or SPLIT/STACK/EXPOSURE/ (ROS 2).

A bag contains what a rig records: the images of the microscope and the poses that the robot
reported. The labels are in files beside it.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Literal

from eyespot.benchmarks.sets.read import SetStack, exposures_of
from eyespot.estimator import Frame, open_source
from eyespot.estimator.sources.ros import write_bag
from eyespot.formats.poses import Pose, read_poses

START_S = 1000.0
"""Time of a bag at the stack's time 0; ROS reads 0 as no time, and poses start before 0."""


def write(
    stacks: Sequence[SetStack], out: Path, progress: Callable[[], None], *, ros: Literal[1, 2]
) -> None:
    """Write the bags, with one image at a time in memory."""
    for entry in stacks:
        folder = out / entry.qualified_name
        for exposure in exposures_of(entry.open()):
            write_bag(
                folder / (f"{exposure}.bag" if ros == 1 else exposure),
                frames=_frames(entry.folder, exposure, progress),
                poses=_poses(entry.folder / "kinematics.csv"),
                ros=ros,
            )


def _frames(folder: Path, exposure: str, progress: Callable[[], None]) -> Iterator[Frame]:
    for frame in open_source(folder, exposure=exposure):
        yield replace(frame, time_s=START_S + frame.time_s)
        progress()


def _poses(report: Path) -> Iterator[Pose]:
    for pose in read_poses(report) if report.is_file() else ():
        yield replace(pose, time_s=START_S + pose.time_s)
