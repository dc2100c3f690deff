"""Reads the robot's poses from a CSV file or a ROS bag."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any

from estimator.files.csv_files import csv_rows, number_in
from estimator.files.poses import Pose, PoseTrack
from estimator.files.ros_bags import is_bag, messages_of, opened_bag, stamp_s, topic_in
from optics import InputError, in_file

POSE_TOPIC = "/eye_robot/FrameEE"
"""The rig's topic of poses: the instrument's tip as a `geometry_msgs/Transform` in mm, which
carries no time stamp.
"""
POSE_MESSAGES = ("geometry_msgs/msg/Transform", "geometry_msgs/msg/PoseStamped")
"""Message types that contain a pose."""

_POSITION = ("x_mm", "y_mm", "z_mm")
_QUATERNION = ("qx", "qy", "qz", "qw")
_AXIS = ("axis_x", "axis_y", "axis_z")


def read_poses(path: str | Path, *, topic: str | None = None) -> PoseTrack:
    """Read the robot's poses from a CSV file or a ROS bag.

    The header of the CSV file names its columns: `time_s, x_mm, y_mm, z_mm`, and either a
    quaternion `qx, qy, qz, qw` or the tool's axis `axis_x, axis_y, axis_z`; other columns are
    ignored. In a bag, a `Transform` is in mm and has the time of its arrival; a `PoseStamped` is
    in m and has the time of its header.

    Args:
        path: of the CSV file or the bag.
        topic: of the poses in a bag; None takes `POSE_TOPIC`, or the only topic with poses.

    Raises:
        InputError: the file is not readable or contains no poses, or the bag has no such topic; the
            message names the file and the line.
    """
    path = Path(path)
    if not path.exists():
        raise InputError(f"{path}: there is no such file. Check the path of the poses.")
    track = PoseTrack(_from_bag(path, topic) if is_bag(path) else _from_csv(path))
    if not len(track):
        raise InputError(f"{path} holds no poses.")
    return track


def _from_bag(path: Path, topic: str | None) -> Iterator[Pose]:
    with opened_bag(path) as reader:
        topic = topic_in(reader, path, topic, kinds=POSE_MESSAGES, usual=POSE_TOPIC)
        for index, (received_s, message) in enumerate(messages_of(reader, path, topic)):
            with in_file(f"{path}, {topic}, message {index}"):
                yield _pose_of_message(message, received_s)


def _pose_of_message(message: Any, received_s: float) -> Pose:
    if isinstance(message, InputError):
        raise message
    if hasattr(message, "translation"):
        time_s, scale = received_s, 1.0
        position, turn = message.translation, message.rotation
    else:
        time_s, scale = stamp_s(message.header) or received_s, 1e3
        position, turn = message.pose.position, message.pose.orientation
    return Pose(
        time_s=time_s,
        position_mm=(scale * position.x, scale * position.y, scale * position.z),
        rotation=(turn.x, turn.y, turn.z, turn.w),
    )


def _from_csv(path: Path) -> Iterator[Pose]:
    direction: tuple[str, ...] = _AXIS

    def check(names: Collection[str]) -> None:
        nonlocal direction
        direction = _QUATERNION if set(_QUATERNION) <= set(names) else _AXIS
        missing = [name for name in ("time_s", *_POSITION, *direction) if name not in names]
        if missing:
            raise InputError(
                f"no poses: column {missing[0]!r} is missing. Name the columns time_s,"
                f" {', '.join(_POSITION)}, and {', '.join(_QUATERNION)} or {', '.join(_AXIS)}."
            )

    for row, where in csv_rows(path, check=check):
        with in_file(where):
            yield _pose(row, direction)


def _pose(row: dict[str, str], direction: tuple[str, ...]) -> Pose:
    time_s, x, y, z = (number_in(row[name], name) for name in ("time_s", *_POSITION))
    towards = [number_in(row[name], name) for name in direction]
    if direction is _AXIS:
        ax, ay, az = towards
        return Pose.along((ax, ay, az), time_s=time_s, position_mm=(x, y, z))
    qx, qy, qz, qw = towards
    return Pose(time_s=time_s, position_mm=(x, y, z), rotation=(qx, qy, qz, qw))
