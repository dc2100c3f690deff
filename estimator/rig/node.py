"""The rig's node: microscope images in, the spot, its axes and its distance out.

    eyespot node _microscope:=/data/microscope.json                   # ROS 1
    eyespot node --ros-args -p microscope:=/data/microscope.json      # ROS 2

`rig` measures; `ros1` and `ros2` connect it to topics. docs/rig.md lists topics and parameters.
"""

import importlib.util
import os
import time
from typing import Annotated, Any

from cyclopts import Parameter

from eyespot.estimator.rig.messages import (
    Silence,
    image_type,
    message_types,
    messages_of,
    status_message,
)
from eyespot.estimator.rig.rig_reader import ImageReader, Parameters, opened_rig
from eyespot.estimator.rig.ros1 import Ros1
from eyespot.estimator.rig.ros2 import Ros2
from eyespot.formats.inputs import InputError


def ros_here() -> type[Ros1] | type[Ros2]:
    """ROS 2 or ROS 1, by the setup file that was sourced, or else by ROS 2's library."""
    sourced = os.environ.get("ROS_VERSION")
    is_ros2 = sourced == "2" if sourced else importlib.util.find_spec("rclpy") is not None
    return Ros2 if is_ros2 else Ros1


class Connection:
    """Subscribes the rig to images and poses, and publishes its outputs."""

    def __init__(self, ros: Ros1 | Ros2, rig: ImageReader, parameters: Parameters) -> None:
        from geometry_msgs.msg import Transform
        from sensor_msgs import msg as sensor

        self._ros, self._rig, self._last = ros, rig, None
        self._complained_s: dict[str, float] = {}
        self._topic = ros.resolved(parameters.image_topic)
        self._silence = Silence(self._topic)
        self._out = {
            name: ros.publisher(getattr(parameters, f"{name}_topic"), kind)
            for name, kind in message_types().items()
        }
        ros.take_poses(parameters.pose_topic, Transform, self._on_pose)
        # A node that cannot keep up skips images and measures the newest.
        kind = getattr(sensor, image_type(self._topic))
        ros.take_images(self._topic, kind, self._on_image)

    def watch(self) -> None:
        """Report images that have stopped."""
        if change := self._silence.change(lambda: self._ros.types_of(self._topic)):
            said, is_fault = change
            self._ros.say(said, is_fault=is_fault)
        if self._silence.said and self._last is not None:
            self._out["status"].publish(status_message("STALE", self._silence.said, self._last))

    def _on_image(self, image: Any, number: int) -> None:
        self._silence.end()
        self._last = image
        output = self._rig.output(image, self._ros.stamp_s(image), number)
        if output.level == "ERROR":
            self._complain("image", output.doubt)
        for name, message in messages_of(output, image).items():
            self._out[name].publish(message)

    def _on_pose(self, pose: Any, received_s: float) -> None:
        try:
            self._rig.poses.take(pose, received_s)
        except InputError as error:
            self._complain("pose", f"{error}")

    def _complain(self, of: str, fault: str) -> None:
        """Log a fault, at most once a second."""
        now_s = time.monotonic()
        if now_s - self._complained_s.get(of, -1.0) >= 1.0:
            self._complained_s[of] = now_s
            self._ros.say(fault, is_fault=True)


def node(*arguments: Annotated[str, Parameter(allow_leading_hyphen=True)]) -> None:
    """Measure a microscope's images under the ROS that is found, until that ROS shuts down.

    Args:
        arguments: Those of ROS: `_NAME:=VALUE` (ROS 1), `--ros-args -p NAME:=VALUE` (ROS 2).
    """
    del arguments  # ROS reads them itself, from sys.argv
    with ros_here().running("eyespot") as ros:
        parameters = ros.parameters()
        with opened_rig(parameters) as rig:
            ros.spin(Connection(ros, rig, parameters).watch)
