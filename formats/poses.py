"""Poses of the robot: where the tip was and in which direction it pointed; from CSV or a bag."""

import math
from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

import numpy as np
from pydantic import AfterValidator, Field
from pydantic import Strict as StrictType

from eyespot.formats.inputs import InputError, Strict, in_file, shortened
from eyespot.formats.pose_columns import (
    AXIS,
    MILLIMETRES,
    POSITION,
    QUATERNION,
    REMEDY,
    ROTATION_VECTOR,
    pose_columns,
    recognised,
)
from eyespot.formats.ros_bags import is_bag, messages_of, opened_bag, stamp_s, topic_in
from eyespot.formats.settings_files import (
    DirectionKey,
    NumberKey,
    PairKey,
    ShareKey,
    SigmaKey,
    VectorKey,
)
from eyespot.formats.tables import LATEST_S, Place, lines_of, numbers, read_table, seconds

if TYPE_CHECKING:
    import pandas as pd
    from jaxtyping import Float

_UNIT_LENGTH_TOLERANCE = 0.01  # tolerance of a unit length: files round
_UNIT_AXIS = "A pose's axis must be a unit vector"
_UNIT_QUATERNION = "A rotation must be a unit quaternion (x, y, z, w)"
_LIMIT_MM = 1e5  # a robot and its eye are in one hall
_LARGEST_TURN = 1.01 * math.tau
"""Longest rotation vector, rad; controllers report up to a whole turn."""

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
        if not (
            abs(self.time_s) <= LATEST_S and all(abs(x) <= _LIMIT_MM for x in self.position_mm)
        ):
            raise InputError(
                "Pose(time_s=..., position_mm=...) must be finite, within"
                f" {LATEST_S:g} s and {_LIMIT_MM:g} mm; got {self.time_s} s, {self.position_mm} mm."
            )
        object.__setattr__(self, "rotation", unit_quaternion(self.rotation))

    @classmethod
    def along(cls, axis: Vector, *, time_s: float, position_mm: Vector) -> Self:
        """The pose that rotates the tool's +z axis to a unit vector by the smallest angle."""
        unit = np.array([*_of_unit_length(axis, _UNIT_AXIS)])
        i, j, k, w = _turns_of_axes(unit[None])[0].tolist()
        return cls(time_s=time_s, position_mm=position_mm, rotation=(i, j, k, w))

    @property
    def axis(self) -> Vector:
        """The tool's +z axis, a unit vector."""
        return turned((0.0, 0.0, 1.0), self.rotation)


def unit_quaternion(rotation: Quaternion) -> Quaternion:
    """A quaternion (x, y, z, w) of unit length, without the rounding of a file.

    Raises:
        InputError: its length is not 1 to a percent.
    """
    x, y, z, w = _of_unit_length(rotation, _UNIT_QUATERNION)
    return x, y, z, w


def _of_unit_length(parts: tuple[float, ...], rule: str) -> Iterator[float]:
    length = math.hypot(*parts)
    if not abs(length - 1) <= _UNIT_LENGTH_TOLERANCE:
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


def _product(second: Any, first: Any) -> tuple[Any, Any, Any, Any]:
    """The quaternion of one rotation after another; parts are numbers or arrays."""
    (a, b, c, d), (i, j, k, w) = second, first
    return (
        d * i + a * w + b * k - c * j,
        d * j + b * w + c * i - a * k,
        d * k + c * w + a * j - b * i,
        d * w - a * i - b * j - c * k,
    )


def _turns_of_axes(axes: "Float[np.ndarray, 'n 3']") -> "Float[np.ndarray, 'n 4']":
    """Unit quaternions of the smallest rotations from +z to unit vectors."""
    x, y, z = axes.T
    # z cross axis, and 1 + z . axis: twice the half-angle's quaternion.
    turns = np.stack([-y, x, np.zeros(len(axes)), 1 + z], axis=1)
    sizes = np.linalg.norm(turns, axis=1, keepdims=True)
    opposite = sizes < 1e-6  # any perpendicular axis
    return np.where(opposite, (1.0, 0.0, 0.0, 0.0), turns / np.where(opposite, 1.0, sizes))


def _of_known_meaning(columns: dict[str, str]) -> dict[str, str]:
    for key in columns:
        if recognised(key) is None:
            raise InputError(
                f"{shortened(key)} is no part of a pose. Known are time_s, time_ms, time_us, "
                f"time_ns, {', '.join((*POSITION, *QUATERNION, *ROTATION_VECTOR, *AXIS))}, travel"
            )
    return columns


_TurnKey = Annotated[
    Annotated[tuple[NumberKey, NumberKey, NumberKey, NumberKey], StrictType(False)],
    AfterValidator(unit_quaternion),
]
_TOUCH_SIGMA_MM = 0.02
"""Accuracy with which an operator finds the contact; the paper's own trials scatter more."""


class RobotKeys(Strict):
    """The robot that moves the instrument, and its file of poses."""

    eye_from_robot: _TurnKey | None = Field(
        None,
        examples=["[0.0, 0.0, 0.0, 1.0]"],
        description="Unit quaternion (x, y, z, w) that turns the robot's frame into the eye's, "
        "whose z points at the microscope; 0, 0, 0, 1 if they agree.",
    )
    tool_axis: Literal["+x", "-x", "+y", "-y", "+z", "-z"] = Field(
        "+z", description="Axis of the tool's frame along which the light leaves it."
    )
    tip_mm: VectorKey = Field(
        (0.0, 0.0, 0.0),
        description="The tip in the tool's frame, for robots that report their flange.",
    )
    unit: Literal["mm", "m", "um"] | None = Field(
        None,
        examples=['"mm"'],
        description="Unit of the positions in its file (default: the one in the columns' names, "
        "else mm; a PoseStamped is in m).",
    )
    columns: Annotated[dict[str, str], AfterValidator(_of_known_meaning)] = Field(
        {},
        description="Names of a CSV's columns, such as { time_s = 'stamp', x = 'px', rx = 'rx' }. "
        "Known: time_s (time_ms, time_us, time_ns); x, y, z; qx, qy, qz, qw or rx, ry, rz "
        "(rotation vector, rad) or axis_x, axis_y, axis_z; travel (of a stage).",
    )
    travel_axis: DirectionKey | None = Field(
        None,
        examples=["[0.5, 0.0, -0.866]"],
        description="Direction of a stage that reports its travel alone: from the tip towards the "
        "wall, in the robot's frame. The travel counts away from the wall.",
    )
    scale_sigma: ShareKey = Field(
        0.01, description="Relative uncertainty of its distances; 0: taken as exact."
    )
    touch: Literal["contact", "free"] | PairKey = Field(
        "contact",
        description="Distance of the tip in the first frame: 'contact' (its rim touches the wall), "
        "'free' (unknown; distances then rest on instrument.core_radius_mm), or [MEAN, SIGMA], mm.",
    )
    touch_sigma_mm: SigmaKey = Field(
        _TOUCH_SIGMA_MM, description="Standard uncertainty of the contact."
    )
    axis_sigma_deg: Annotated[float, Field(ge=0, lt=90)] = Field(
        1.0, description="Standard uncertainty of the beam's axis, across itself."
    )
    incidence_deg: PairKey = Field(
        (0.0, 32.0),
        description="Least and largest incidence of the beam where no axis is known.",
    )
    clock_offset_s: NumberKey = Field(
        0.0, description="Added to the poses' times to get those of the images."
    )
    clock_sigma_s: SigmaKey = Field(
        0.05,
        description="Standard uncertainty of that offset. 0.05 suits poses without stamps, which "
        "count from their arrival; 0: one clock.",
    )
    image_topic: str | None = Field(
        None, examples=['"/camera/image_raw"'], description="Image topic of a bag or a ROS."
    )
    pose_topic: str | None = Field(
        None, examples=['"/robot/pose"'], description="Pose topic of a bag or a ROS."
    )


_TOOL_AXES = {
    f"{sign}{name}": tuple(float(f"{sign}1") * (name == other) for other in POSITION)
    for sign in "+-"
    for name in POSITION
}


class PoseTrack:
    """Poses by time.

    Attributes:
        times_s: (n,), s, in order.
        positions_mm: (n, 3), of the tip.
        rotations: (n, 4), as `Pose.rotation`.
    """

    def __init__(self, poses: Iterable[Pose]) -> None:
        rows = [(p.time_s, *p.position_mm, *p.rotation) for p in poses]
        values = np.array(rows, dtype=float).reshape(-1, 8)
        self._keep(values[:, 0], values[:, 1:4], values[:, 4:])

    @classmethod
    def of_arrays(
        cls,
        times_s: "Float[np.ndarray, 'n']",
        positions_mm: "Float[np.ndarray, 'n 3']",
        rotations: "Float[np.ndarray, 'n 4']",
    ) -> Self:
        """Poses from arrays, which are taken as they are: rotations have unit length."""
        track = cls(())
        track._keep(times_s, positions_mm, rotations)
        return track

    def _keep(self, times_s: np.ndarray, positions_mm: np.ndarray, rotations: np.ndarray) -> None:
        order = np.argsort(times_s, kind="stable")
        self.times_s, self.positions_mm = times_s[order], positions_mm[order]
        self.rotations = rotations[order]

    @property
    def axes(self) -> "Float[np.ndarray, 'n 3']":
        """The tool's +z axis in each pose, unit vectors."""
        return self._turned((0.0, 0.0, 1.0))

    def _turned(self, vector: Vector) -> "Float[np.ndarray, 'n 3']":
        """A vector of the tool's frame in the recorder's, for each pose."""
        parts: Any = self.rotations.T
        rows: Any = turned(vector, parts)
        return np.stack(rows, axis=1)

    def of_light(self, robot: RobotKeys) -> "PoseTrack":
        """The poses of the tip, whose +z axis the light follows, from those of a robot.

        Args:
            robot: its `tool_axis`, `tip_mm` and `clock_offset_s` lead from what it reports to the
                tip, the light and the images' clock.
        """
        towards = _turns_of_axes(np.array([_TOOL_AXES[robot.tool_axis]]))
        return PoseTrack.of_arrays(
            self.times_s + robot.clock_offset_s,
            self.positions_mm + self._turned(robot.tip_mm),
            np.stack(_product(self.rotations.T, towards.T), axis=1),
        )

    def _pose(self, row: int) -> Pose:
        x, y, z = self.positions_mm[row].tolist()
        i, j, k, w = self.rotations[row].tolist()
        return Pose(time_s=float(self.times_s[row]), position_mm=(x, y, z), rotation=(i, j, k, w))

    def __len__(self) -> int:
        return len(self.times_s)

    def __iter__(self) -> Iterator[Pose]:
        return map(self._pose, range(len(self)))

    def between(self, after_s: float, until_s: float) -> list[Pose]:
        """The poses after one time, up to another."""
        begin, end = np.searchsorted(self.times_s, (after_s, until_s), side="right").tolist()
        return [self._pose(row) for row in range(begin, end)]

    def at(self, time_s: float) -> tuple[Pose, float] | None:
        """The pose that was known at a time.

        Returns:
            The latest pose that is not after `time_s`, and its age in s; None if there is none or
            the time is NaN.
        """
        following = int(np.searchsorted(self.times_s, time_s, side="right"))
        if following == 0 or math.isnan(time_s):
            return None
        pose = self._pose(following - 1)
        return pose, time_s - pose.time_s

    def interpolated(self, time_s: float) -> Pose | None:
        """The pose at a time between two poses; None outside of all of them."""
        following = int(np.searchsorted(self.times_s, time_s, side="right"))
        if following == len(self) > 0 and self.times_s[-1] == time_s:  # nothing follows it
            return self._pose(-1)
        if not 0 < following < len(self):
            return None
        pair = slice(following - 1, following + 1)
        begin_s, end_s = self.times_s[pair].tolist()
        share = (time_s - begin_s) / (end_s - begin_s)
        shares = np.array([1 - share, share])
        x, y, z = (shares @ self.positions_mm[pair]).tolist()
        before, after = self.rotations[pair]
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


def read_poses(path: str | Path, *, robot: RobotKeys | None = None) -> PoseTrack:
    """Read the robot's poses from a CSV file or a ROS bag.

    The header of a CSV file names its columns, see `poses_of_table`. In a bag, a `Transform` is in
    mm and has the time of its arrival; a `PoseStamped` is in m and has the time of its header.

    Args:
        robot: its unit, columns, topic, tool and clock; None is one whose file says it all.

    Raises:
        InputError: the file is not readable or contains no poses, or the bag has no such topic; the
            message names the file and the line.
    """
    path, robot = Path(path), robot or RobotKeys()
    if not path.exists():
        raise InputError(f"{path}: there is no such file. Check the path of the poses.")
    if is_bag(path):
        track = PoseTrack(_from_bag(path, robot)).of_light(robot)
    else:
        track = _from_table(read_table(path), robot, where=f"{path}", place=lines_of(path))
    if not len(track):
        raise InputError(f"{path} holds no poses.")
    return track


def _from_bag(path: Path, robot: RobotKeys) -> Iterator[Pose]:
    with opened_bag(path) as reader:
        topic = topic_in(reader, path, robot.pose_topic, kinds=POSE_MESSAGES, usual=POSE_TOPIC)
        for index, (received_s, message) in enumerate(messages_of(reader, path, topic)):
            with in_file(f"{path}, {topic}, message {index}"):
                if isinstance(message, InputError):
                    raise message
                yield _reported(message, received_s, robot)


def pose_of_message(message: Any, received_s: float, robot: RobotKeys | None = None) -> Pose:
    """The tip's pose, see `PoseTrack.of_light`, from a `Transform` or a `PoseStamped`.

    Args:
        received_s: when it arrived, s.
        robot: see `read_poses`.

    Raises:
        InputError: its rotation is no unit quaternion, or a number is not finite.
    """
    robot = robot or RobotKeys()
    (pose,) = PoseTrack([_reported(message, received_s, robot)]).of_light(robot)
    return pose


def _reported(message: Any, received_s: float, robot: RobotKeys) -> Pose:
    if hasattr(message, "translation"):
        time_s, unit = received_s, "mm"
        position, turn = message.translation, message.rotation
    else:
        time_s, unit = stamp_s(message.header) or received_s, "m"
        position, turn = message.pose.position, message.pose.orientation
    scale = MILLIMETRES[robot.unit or unit]
    return Pose(
        time_s=time_s,
        position_mm=(scale * position.x, scale * position.y, scale * position.z),
        rotation=(turn.x, turn.y, turn.z, turn.w),
    )


def poses_of_table(
    table: "pd.DataFrame", *, robot: RobotKeys | None = None, where: str = "poses"
) -> PoseTrack:
    """The tip's poses, see `PoseTrack.of_light`, from a table with one of the robot's in each row.

    Columns are recognised by their names: a time (`time_s`, `t_ms`, `stamp`, ...; s without a unit;
    or after ISO 8601); a position (`x_mm`, `px`, `pos_y_m`, ...; mm without a unit); a direction:
    a quaternion (`qx` to `qw`), a rotation vector (`rx`, `ry`, `rz`, rad), or the tool's axis
    (`axis_x`, ...); or a stage's `travel` away from the wall alone. Others are ignored.

    Args:
        robot: states names and units of columns that do not say it, and the direction of a stage.
        where: name of the table, for messages.

    Raises:
        InputError: a column is missing or can be several, units contradict each other, a value is
            no number, a direction has no unit length, or times go back.
    """
    robot = robot or RobotKeys()
    track = _from_table(table, robot, where=where, place=lambda row: f"{where}, row {row}")
    if not len(track):
        raise InputError(f"{where} holds no poses.")
    return track


def _from_table(table: "pd.DataFrame", robot: RobotKeys, *, where: str, place: Place) -> PoseTrack:
    with in_file(where):
        names = [f"{name}" for name in table.columns]
        columns = pose_columns(names, stated=robot.columns, unit=robot.unit)
        parts = _direction_parts(columns.keys(), robot, ", ".join(map(shortened, names[:40])))

    def values(parts: Iterable[str]) -> "Float[np.ndarray, 'n k']":
        rows = [numbers(table[columns[p].name], place) * columns[p].unit for p in parts]
        return np.array(rows).reshape(len(rows), len(table)).T

    times_s = seconds(table[columns["time"].name], place, unit_s=columns["time"].unit)
    for row in np.flatnonzero(np.diff(times_s) < 0)[:1]:
        raise InputError(
            f"{place(row + 1)}: the time goes back from {times_s[row]:.6f} to "
            f"{times_s[row + 1]:.6f} s, as if two recordings were in one file or the clock was set "
            "back. Keep one recording, or sort its rows by time."
        )
    rotations = _rotations(parts, values(parts), robot, place)
    if columns.keys() >= set(POSITION):
        positions = values(POSITION)
    else:
        positions = -values(["travel"]) * np.array(robot.travel_axis)
    for row in np.flatnonzero(~(np.abs(positions) <= _LIMIT_MM).all(axis=1))[:1]:
        raise InputError(
            f"{place(row)}: a position must be within {_LIMIT_MM:g} mm; got {positions[row]} mm. "
            "Correct robot.unit or robot.columns."
        )
    return PoseTrack.of_arrays(times_s, positions, rotations).of_light(robot)


def _direction_parts(names: Collection[str], robot: RobotKeys, listed: str) -> tuple[str, ...]:
    """The parts that give the tool's direction; none for a stage, whose direction is stated."""
    is_stage = not set(names) >= set(POSITION)
    parts = next((p for p in (QUATERNION, ROTATION_VECTOR, AXIS) if set(names) >= set(p)), ())
    if robot.travel_axis is None and (is_stage or not parts):
        raise InputError(
            f"no direction of the tool among the columns {listed}. A stage's travel needs "
            "robot.travel_axis, from the tip towards the wall, such as [0.5, 0.0, -0.866]. Other "
            f"robots give {', '.join(QUATERNION)}, {', '.join(ROTATION_VECTOR)} (rotation vector) "
            f"or {', '.join(AXIS)}. {REMEDY}"
        )
    known = {AXIS: ("+z", "-z"), (): ("+z",)}.get(parts, tuple(_TOOL_AXES))
    if robot.tool_axis not in known or (len(known) < len(_TOOL_AXES) and any(robot.tip_mm[:2])):
        raise InputError(
            f"robot.tool_axis = {robot.tool_axis!r} and robot.tip_mm = {list(robot.tip_mm)} need "
            "the tool's whole rotation, but the file has its axis alone. Then tool_axis can be "
            f"{' or '.join(known)}, and tip_mm is [0, 0, z]."
        )
    return parts


def _rotations(
    parts: tuple[str, ...], directions: "Float[np.ndarray, 'n k']", robot: RobotKeys, place: Place
) -> "Float[np.ndarray, 'n 4']":
    """Unit quaternions from quaternions, rotation vectors, axes, or a stage's stated axis."""
    if robot.travel_axis is not None and not parts:
        return np.tile(_turns_of_axes(np.array([robot.travel_axis])), (len(directions), 1))
    sizes = np.linalg.norm(directions, axis=1, keepdims=True)
    if parts == ROTATION_VECTOR:
        for row in np.flatnonzero(sizes > _LARGEST_TURN)[:1]:
            raise InputError(
                f"{place(row)}: a rotation vector must be at most a whole turn long; got "
                f"{sizes[row, 0]:.4g} rad. Write it in rad, not in degrees."
            )
        return np.hstack([np.sinc(sizes / math.tau) / 2 * directions, np.cos(sizes / 2)])
    rule = _UNIT_AXIS if parts == AXIS else _UNIT_QUATERNION
    for row in np.flatnonzero(~(np.abs(sizes - 1) <= _UNIT_LENGTH_TOLERANCE))[:1]:
        with in_file(place(row)):
            list(_of_unit_length(tuple(directions[row].tolist()), rule))
    return _turns_of_axes(directions / sizes) if parts == AXIS else directions / sizes
