"""Measures the images of the rig: parameters, poses and images in, outputs out.

Nothing here needs ROS: a message is any object with its fields. `node` connects this to topics.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from estimator.files import POSE_TOPIC, Pose, PoseTrack
from estimator.image import Spot
from estimator.run import Options, Reading
from estimator.sources import IMAGE_TOPIC, frame_of_message

POSES_KEPT = 400  # two seconds at the robot's 200 Hz; images reach the node sooner


class Parameters(Options):
    """Private parameters of the node, such as `~mode`: the options, and names of topics.

    Attributes:
        image_topic: `sensor_msgs/Image`.
        pose_topic: `geometry_msgs/Transform`, mm.
        spot_topic: `geometry_msgs/PointStamped`.
        axes_topic: `geometry_msgs/Vector3Stamped`.
        range_topic: `sensor_msgs/Range`.
        status_topic: `diagnostic_msgs/DiagnosticArray`.
    """

    image_topic: str = IMAGE_TOPIC
    pose_topic: str = POSE_TOPIC
    spot_topic: str = "~spot"
    axes_topic: str = "~axes"
    range_topic: str = "~range"
    status_topic: str = "~status"


class Output(NamedTuple):
    """A reading in the form of the messages.

    Attributes:
        centre: x and y, px, and 1; NaN, NaN, 0 where there is no spot.
        axes: semi-major and semi-minor axis, px, and the former's angle, rad; NaN without a spot.
        distance_m: from the tip to the wall along the beam; NaN where there is none.
        doubt: see `Reading.doubt`.
        details: the rest, named and written as in the spots file.
    """

    centre: tuple[float, float, float]
    axes: tuple[float, float, float]
    distance_m: float
    doubt: str
    details: dict[str, str]


class Rig:
    """Measures images in the order of arrival, with the last spot and the latest poses.

    Args:
        parameters: of the node.

    Raises:
        InputError: parameters or files are wrong, alone or together.
        OSError: a file cannot be read.
    """

    def __init__(self, parameters: Parameters) -> None:
        self._reader = parameters.reader()
        self._poses: tuple[Pose, ...] = ()

    def take_pose(self, message: Any, received_s: float) -> None:
        """Remember a pose.

        Args:
            message: `geometry_msgs/Transform`, mm.
            received_s: when it arrived, s: the message has no time stamp.

        Raises:
            InputError: its rotation is no unit quaternion, or a number is not finite.
        """
        position, turn = message.translation, message.rotation
        pose = Pose(
            time_s=received_s,
            position_mm=(position.x, position.y, position.z),
            rotation=(turn.x, turn.y, turn.z, turn.w),
        )
        # Poses arrive in another thread. A tuple is replaced as a whole, never half changed.
        self._poses = (*self._poses[1 - POSES_KEPT :], pose)

    def measured(self, message: Any, time_s: float) -> Output:
        """Measure an image.

        Args:
            message: `sensor_msgs/Image`.
            time_s: of its header, s.

        Raises:
            InputError: it cannot be decoded, or as `Reader.read`.
        """
        image = frame_of_message(message)
        return _output(self._reader.read(image, time_s=time_s, poses=PoseTrack(self._poses)))


def _output(reading: Reading) -> Output:
    spot, distance = reading.result, reading.range
    centre, axes = (math.nan, math.nan, 0.0), (math.nan, math.nan, math.nan)
    details = {"pose_age_s": reading.pose_age_s}
    if isinstance(spot, Spot):
        centre = (spot.x_px, spot.y_px, 1.0)
        axes = (spot.semi_major_px, spot.semi_minor_px, spot.angle_rad)
        for name in ("sigma_semi_minor_px", "edge_width_px", "coverage", "saturated"):
            details[name] = getattr(spot, name)
    if distance is not None:
        details["sigma_distance_mm"] = distance.sigma_mm
        details |= {f"other_distance_{n}_mm": d for n, d in enumerate(distance.others_mm, 1)}
    return Output(
        centre=centre,
        axes=axes,
        distance_m=reading.distance_mm / 1e3,
        doubt=reading.doubt,
        details={name: repr(float(value)) for name, value in details.items()},
    )
