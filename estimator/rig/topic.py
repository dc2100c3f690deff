"""A topic of images as a live source, under the ROS that is there."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable, Collection, Iterator
from itertools import count
from typing import Any

from estimator.rig.messages import PERIOD_S, Silence, image_type
from estimator.rig.node import is_ros2
from estimator.rig.rig import POSES_KEPT, RecentPoses
from estimator.rig.ros1 import BUFFER_BYTES, imported_rospy
from estimator.sources.ros import decoded_frame
from estimator.sources.source import Frame, Source
from formats.inputs import InputError
from formats.poses import POSE_TOPIC
from formats.ros_bags import stamp_s

_NAME = "eyespot_console"


def open_topic(
    topic: str, *, poses: RecentPoses | None = None, pose_topic: str = POSE_TOPIC
) -> Source:
    """Subscribe to a topic; the source gives the newest image, and skips those that it misses.

    Reading raises an InputError, with the cause, where images stop; read again for the next ones.

    Args:
        topic: of `sensor_msgs/Image`, or CompressedImage if it ends in /compressed.
        poses: take the poses of the robot, at their time of arrival; None for no poses.
        pose_topic: of `geometry_msgs/Transform`, mm.

    Raises:
        InputError: ROS is not installed, or this is no topic's name.
    """
    newest = _Newest()
    types = (_subscribed_ros2 if is_ros2() else _subscribed_ros1)(topic, newest, poses, pose_topic)

    def read() -> Iterator[Frame]:
        silence = Silence(topic)
        for index in count():
            while (image := newest.taken(PERIOD_S)) is None:
                change = silence.change(types)
                if change is not None and change[1]:
                    raise InputError(change[0])
            silence.end()
            stamp = image.header.stamp
            time_s = stamp.to_sec() if hasattr(stamp, "to_sec") else stamp_s(image.header)
            yield decoded_frame(image, index=index, time_s=time_s)

    return Source(name=topic, read=read, live=True)


class _Newest:
    """The newest message that nobody has taken yet."""

    def __init__(self) -> None:
        self._message: Any = None
        self._arrived = threading.Condition()

    def put(self, message: Any) -> None:
        with self._arrived:
            self._message = message
            self._arrived.notify()

    def taken(self, seconds: float) -> Any:
        """Wait for a message; None if there is none in time."""
        with self._arrived:
            self._arrived.wait_for(lambda: self._message is not None, seconds)
            message, self._message = self._message, None
        return message


def _taking(poses: RecentPoses, clock: Callable[[], float]) -> Callable[[Any], None]:
    """Takes a message; one that is no pose is left out, and the poses before it stay."""

    def take(message: Any) -> None:
        with contextlib.suppress(InputError):
            poses.take(message, clock())

    return take


def _subscribed_ros1(
    topic: str, newest: _Newest, poses: RecentPoses | None, pose_topic: str
) -> Callable[[], Collection[str]]:
    rospy = imported_rospy()
    from geometry_msgs.msg import Transform
    from sensor_msgs import msg as sensor

    rospy.init_node(_NAME, anonymous=True, disable_signals=True)
    kind = getattr(sensor, image_type(topic))
    rospy.Subscriber(topic, kind, newest.put, queue_size=1, buff_size=BUFFER_BYTES)
    if poses is not None:
        take = _taking(poses, rospy.get_time)
        rospy.Subscriber(pose_topic, Transform, take, queue_size=POSES_KEPT)
    name = rospy.resolve_name(topic)
    return lambda: [kind for other, kind in rospy.get_published_topics() if other == name]


def _subscribed_ros2(
    topic: str, newest: _Newest, poses: RecentPoses | None, pose_topic: str
) -> Callable[[], Collection[str]]:
    import rclpy
    from geometry_msgs.msg import Transform
    from rclpy.qos import QoSProfile, QoSReliabilityPolicy
    from sensor_msgs import msg as sensor

    from estimator.rig.ros2 import check_topics

    check_topics(topic, pose_topic)
    # The program ends by its own handlers of signals.
    rclpy.init(args=[], signal_handler_options=rclpy.signals.SignalHandlerOptions.NO)
    node = rclpy.create_node(_NAME)
    qos = QoSProfile(depth=1, reliability=QoSReliabilityPolicy.BEST_EFFORT)
    node.create_subscription(getattr(sensor, image_type(topic)), topic, newest.put, qos)
    if poses is not None:
        every = QoSProfile(depth=POSES_KEPT, reliability=QoSReliabilityPolicy.BEST_EFFORT)
        take = _taking(poses, lambda: node.get_clock().now().nanoseconds / 1e9)
        node.create_subscription(Transform, pose_topic, take, every)
    threading.Thread(target=rclpy.spin, args=(node,), daemon=True).start()
    return lambda: [about.topic_type for about in node.get_publishers_info_by_topic(topic)]
