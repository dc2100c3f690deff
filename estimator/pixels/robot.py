"""How the tool has moved from the first frame to another one, as the robot says it.

A robot knows its own motion much better than where the eye is and how the fibre sits in the tool.
So the first frame of a wall may be anywhere, and the others are where the robot moved from there.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from estimator.pixels.beam import POSE, Pose

_TURNED = 0.02
"""Relative error of a motion in the eye's frame, for an `eye_from_robot` that is 1 degree off."""
_TURN = math.radians(0.05)  # error of the robot's own turn
_FREEDOM = 10.0  # of Student's distribution; a robot that is wrong loses its weight


class RobotPose(NamedTuple):
    """The tool, in the middle of an exposure.

    Attributes:
        tip: place of the tip, mm, in axes along the eye frame's.
        axis: direction of the beam by the tool's, which may be off by some degrees, but always
            alike as long as the tool does not roll.
        sigma: standard deviation of `tip`, mm, by the robot and its clock.
    """

    tip: Float[np.ndarray, "3"]
    axis: Float[np.ndarray, "3"]
    sigma: float


class Motion(NamedTuple):
    """What the robot says of two frames, less what is believed of them.

    Attributes:
        rest: of the change of the tip, mm, and of two turns of the axis, rad.
        slopes: derivatives of what is believed by the later pose.
        first_slopes: by the first pose.
        precision: 1 over the variances of `rest`.
    """

    rest: Float[np.ndarray, "5"]
    slopes: Float[np.ndarray, "5 5"]
    first_slopes: Float[np.ndarray, "5 5"]
    precision: Float[np.ndarray, "5"]

    def after(self, by: Float[np.ndarray, "5"], by_first: Float[np.ndarray, "5"]) -> Motion:
        """After small changes of the two poses."""
        rest = self.rest - self.slopes @ by - self.first_slopes @ by_first
        return self._replace(rest=rest)

    @property
    def cost(self) -> float:
        """-2 log likelihood, up to a constant."""
        return float(_FREEDOM * math.log1p(self._chi_squared / _FREEDOM))

    @property
    def weight(self) -> Float[np.ndarray, "5"]:
        """`precision`, less where the robot is wrong."""
        return self.precision / (1.0 + self._chi_squared / _FREEDOM)

    @property
    def _chi_squared(self) -> float:
        return float(self.precision @ np.square(self.rest))


def motion_between(
    first: tuple[Pose, RobotPose | None], later: tuple[Pose, RobotPose | None]
) -> Motion | None:
    """The motion between two frames with their poses; None if the robot says nothing of one."""
    (pose_0, robot_0), (pose, robot) = first, later
    if robot_0 is None or robot is None:
        return None
    told, (turn, angle) = robot.tip - robot_0.tip, _turn(robot_0.axis, robot.axis)
    across = np.stack([pose.first, pose.second])
    rest = np.concatenate(
        [told - (pose.tip - pose_0.tip), across @ (turn @ pose_0.axis - pose.axis)]
    )
    first_slopes = np.zeros((POSE, POSE))
    first_slopes[:3] = -pose_0.slopes[:3]
    first_slopes[3:, 3:] = -across @ turn @ np.stack([pose_0.first, pose_0.second], axis=-1)
    place = math.hypot(robot.sigma, robot_0.sigma, _TURNED * float(np.linalg.norm(told)))
    return Motion(
        rest=rest,
        slopes=pose.slopes,
        first_slopes=first_slopes,
        precision=np.repeat([place, math.hypot(_TURN, _TURNED * angle)], [3, 2]) ** -2.0,
    )


def _turn(first: np.ndarray, later: np.ndarray) -> tuple[Float[np.ndarray, "3 3"], float]:
    """The least rotation from one unit vector to another, and its angle, rad."""
    axis = np.cross(first, later)
    cross = np.cross(np.eye(3), axis)  # rows: e_i x axis; as a matrix it turns about the axis
    cosine = float(first @ later)
    angle = math.atan2(float(np.linalg.norm(axis)), cosine)
    return np.eye(3) + cross + cross @ cross / (1.0 + cosine), angle
