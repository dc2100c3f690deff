"""Poses of the robot: where the tip was and in which direction it pointed; from CSV or a bag."""

import bisect
import math
from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import numpy as np

from eyespot.formats.inputs import InputError, csv_rows, in_file, number_in
from eyespot.formats.ros_bags import is_bag, messages_of, opened_bag, stamp_s, topic_in

_UNIT = 0.01  # tolerance of a unit length: files round
_LATEST_S = 1e11  # clocks count from 1970; more is no time
_FAR_MM = 1e6

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]


@dataclass(frozen=True, kw_only=True)
class Pose:
    """The tool at one moment, in the recorder's frame of reference.

    Attributes:
        time_s: on the clock of the frames.
        position_mm: of the tip.
        rotation: unit quaternion (x, y, z, w) that turns the tool's frame into the recorder's.
    """

    time_s: float
    position_mm: Vector
    rotation: Quaternion = (0.0, 0.0, 0.0, 1.0)

    def __post_init__(self) -> None:
        """Refuse invalid poses, and normalise the quaternion."""
        if not (abs(self.time_s) <= _LATEST_S and all(abs(x) <= _FAR_MM for x in self.position_mm)):
            raise InputError(
                "Pose(time_s=..., position_mm=...) must be finite, within"
                f" {_LATEST_S:g} s and {_FAR_MM:g} mm; got {self.time_s} s, {self.position_mm} mm."
            )
        object.__setattr__(self, "rotation", unit_quaternion(self.rotation))

    @classmethod
    def along(cls, axis: Vector, *, time_s: float, position_mm: Vector) -> Self:
        """The pose that rotates the tool's +z axis to a unit vector by the smallest angle."""
        x, y, z = _of_unit_length(axis, "A pose's axis must be a unit vector")
        # z cross axis, and 1 + z . axis: twice the half-angle's quaternion.
        turn = (-y, x, 0.0, 1 + z)
        size = math.hypot(*turn)
        rotation = (1.0, 0.0, 0.0, 0.0)  # opposite direction: any perpendicular axis
        if size > 1e-6:
            rotation = (turn[0] / size, turn[1] / size, 0.0, turn[3] / size)
        return cls(time_s=time_s, position_mm=position_mm, rotation=rotation)

    @property
    def axis(self) -> Vector:
        """The tool's +z axis, a unit vector."""
        return turned((0.0, 0.0, 1.0), self.rotation)


def unit_quaternion(rotation: Quaternion) -> Quaternion:
    """A quaternion (x, y, z, w) of unit length, without the rounding of a file.

    Raises:
        InputError: its length is not 1 to a percent.
    """
    x, y, z, w = _of_unit_length(rotation, "A rotation must be a unit quaternion (x, y, z, w)")
    return x, y, z, w


def _of_unit_length(parts: tuple[float, ...], rule: str) -> Iterator[float]:
    length = math.hypot(*parts)
    if not abs(length - 1) <= _UNIT:
        raise InputError(f"{rule}; got {parts}, of length {length:.3g}.")
    return (part / length for part in parts)


def turned(vector: Vector, rotation: Quaternion) -> Vector:
    """A vector rotated by a unit quaternion (x, y, z, w)."""
    (i, j, k, w), (x, y, z) = rotation, vector
    # Written out: NumPy's cross product takes ten times as long, and a frame has dozens of them.
    a, b, c = 2 * (j * z - k * y), 2 * (k * x - i * z), 2 * (i * y - j * x)
    return (
        x + w * a + j * c - k * b,
        y + w * b + k * a - i * c,
        z + w * c + i * b - j * a,
    )


class PoseTrack:
    """Poses by time."""

    def __init__(self, poses: Iterable[Pose]) -> None:
        self._poses = sorted(poses, key=lambda pose: pose.time_s)
        self._times = [pose.time_s for pose in self._poses]

    def __len__(self) -> int:
        return len(self._poses)

    def __iter__(self) -> Iterator[Pose]:
        return iter(self._poses)

    def between(self, after_s: float, until_s: float) -> list[Pose]:
        """The poses after one time, up to another."""
        begin, end = (bisect.bisect_right(self._times, time_s) for time_s in (after_s, until_s))
        return self._poses[begin:end]

    def at(self, time_s: float) -> tuple[Pose, float] | None:
        """The pose that was known at a time.

        Returns:
            The latest pose that is not after `time_s`, and its age in s; None if there is none or
            the time is NaN.
        """
        following = bisect.bisect_right(self._times, time_s)
        if following == 0 or math.isnan(time_s):
            return None
        pose = self._poses[following - 1]
        return pose, time_s - pose.time_s

    def interpolated(self, time_s: float) -> Pose | None:
        """The pose at a time between two poses; None outside of all of them."""
        if self._times[-1:] == [time_s]:  # nothing follows the last pose
            return self._poses[-1]
        following = bisect.bisect_right(self._times, time_s)
        if not 0 < following < len(self._times):
            return None
        pair = self._poses[following - 1 : following + 1]
        share = (time_s - pair[0].time_s) / (pair[1].time_s - pair[0].time_s)
        shares = np.array([1 - share, share])
        x, y, z = (shares @ [pose.position_mm for pose in pair]).tolist()
        before, after = np.array([pose.rotation for pose in pair])
        # q and -q are the same rotation.
        turn = shares @ np.stack([before, math.copysign(1.0, before @ after) * after])
        i, j, k, w = (turn / np.linalg.norm(turn)).tolist()
        return Pose(time_s=time_s, position_mm=(x, y, z), rotation=(i, j, k, w))


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
                if isinstance(message, InputError):
                    raise message
                yield pose_of_message(message, received_s)


def pose_of_message(message: Any, received_s: float) -> Pose:
    """The pose in a `Transform`, mm, or a `PoseStamped`, m, that arrived at a time, s.

    Raises:
        InputError: its rotation is no unit quaternion, or a number is not finite.
    """
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
            time_s, x, y, z = (number_in(row[name], name) for name in ("time_s", *_POSITION))
            towards: Any = tuple(number_in(row[name], name) for name in direction)
            if direction is _AXIS:
                yield Pose.along(towards, time_s=time_s, position_mm=(x, y, z))
            else:
                yield Pose(time_s=time_s, position_mm=(x, y, z), rotation=towards)
