"""The node under ROS 1."""

from __future__ import annotations

import importlib
import sys
from typing import Any

from estimator.rig.messages import (
    PERIOD_S,
    Silence,
    image_type,
    message_types,
    messages_of,
    silence_message,
    topics_of,
)
from estimator.rig.rig import POSES_KEPT, OutputState, Parameters, Rig, opened_rig
from formats.inputs import InputError

_DEBIAN_PACKAGES = "/usr/lib/python3/dist-packages"  # rospy, outside of environments
# Larger than an uncompressed 1920x1080 RGB image (6.2 MB). In a smaller buffer old images wait, so
# that the next image is not the newest.
BUFFER_BYTES = 2**25


def run() -> None:
    """Run the node until ROS shuts down.

    Raises:
        InputError: ROS is not installed, or parameters or files are wrong.
        OSError: a file cannot be read.
    """
    rospy = imported_rospy()
    rospy.init_node("eyespot")
    parameters = Parameters.of(rospy.get_param("~", {}))
    with opened_rig(parameters) as rig:
        connection = Ros1Connection(rig, parameters)
        while not rospy.is_shutdown():
            rospy.rostime.wallsleep(PERIOD_S)
            connection.watch()


class Ros1Connection:
    """Subscribes the rig to images and poses, and publishes its outputs."""

    def __init__(self, rig: Rig, parameters: Parameters) -> None:
        import rospy
        from geometry_msgs.msg import Transform
        from sensor_msgs import msg as sensor

        self._rig, self._last = rig, None
        self._topic = _resolved(parameters.image_topic)
        self._silence = Silence(self._topic)
        self._out = [
            rospy.Publisher(_resolved(topic), kind, queue_size=10)
            for topic, kind in zip(topics_of(parameters), message_types(), strict=True)
        ]
        poses = _resolved(parameters.pose_topic)
        rospy.Subscriber(poses, Transform, self._on_pose, queue_size=POSES_KEPT)
        # At most one image waits: a node that cannot keep up skips images and measures the newest.
        kind = getattr(sensor, image_type(self._topic))
        rospy.Subscriber(self._topic, kind, self._on_image, queue_size=1, buff_size=BUFFER_BYTES)

    def watch(self) -> None:
        """Report images that have stopped; call this every `PERIOD_S`."""
        import rospy

        def types() -> list[str]:
            return [kind for name, kind in rospy.get_published_topics() if name == self._topic]

        if change := self._silence.change(types):
            said, is_fault = change
            (rospy.logerr if is_fault else rospy.loginfo)(said)
        if self._silence.said and self._last is not None:
            self._out[-1].publish(silence_message(self._silence.said, self._last))

    def _on_image(self, image: Any) -> None:
        import rospy

        self._silence.end()
        self._last = image
        output = self._rig.output(image, image.header.stamp.to_sec(), image.header.seq)
        if output.level is OutputState.FAILED:
            rospy.logerr_throttle(1.0, output.doubt)
        for publisher, message in zip(self._out, messages_of(output, image), strict=True):
            if message is not None:
                publisher.publish(message)

    def _on_pose(self, pose: Any) -> None:
        import rospy

        try:
            self._rig.poses.take(pose, rospy.get_time())
        except InputError as error:
            rospy.logerr_throttle(1.0, f"{error}")


def _resolved(topic: str) -> str:
    """The whole name of a topic; ROS 1 writes ~name for what ROS 2 writes as ~/name."""
    import rospy

    return rospy.resolve_name(topic.replace("~/", "~", 1))


def imported_rospy() -> Any:
    """ROS's library for Python, which is not installed in the environment.

    Raises:
        InputError: ROS is not installed.
    """
    # At the end of the path, so that it hides no package of the environment. The folders of a ROS
    # whose setup file was sourced come first.
    sys.path.append(_DEBIAN_PACKAGES)
    try:
        return importlib.import_module("rospy")
    except ModuleNotFoundError as error:
        raise InputError(
            f"ROS is not installed: {error}. Source the setup file of your ROS (ROS 1, or ROS 2"
            " Jazzy or later), or run tools/install-ros for Debian's ROS 1."
        ) from error
