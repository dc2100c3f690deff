"""Poses of the robot: where the instrument's tip was, and in which direction it pointed."""

from __future__ import annotations

import bisect
import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Self

import numpy as np

from optics import InputError

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
    def along(
        cls,
        axis: Vector,
        *,
        time_s: float,
        position_mm: Vector,
    ) -> Self:
        """The pose that rotates the tool's +z axis to a unit vector by the smallest angle."""
        x, y, z = _of_unit_length(axis, "A pose's axis must be a unit vector")
        # z cross axis, and 1 + z . axis: twice the half-angle's quaternion.
        turn = (-y, x, 0.0, 1 + z)
        size = math.hypot(*turn)
        rotation = (
            1.0,
            0.0,
            0.0,
            0.0,
        )  # opposite direction: any perpendicular axis
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
    """Poses by time.

    Args:
        poses: in any order.
    """

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
