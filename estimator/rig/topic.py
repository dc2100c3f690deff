"""A topic of images as a live source, under the ROS that is there."""

from collections.abc import Iterator
from contextlib import suppress
from queue import Empty, Full, Queue
from typing import Any

from eyespot.estimator.rig.messages import PERIOD_S, Silence, image_type
from eyespot.estimator.rig.node import ros_here
from eyespot.estimator.rig.rig_reader import RecentPoses
from eyespot.estimator.sources.ros import decoded_frame
from eyespot.estimator.sources.source import Frame, Source
from eyespot.formats.inputs import InputError
from eyespot.formats.poses import POSE_TOPIC


def open_topic(topic: str, *, poses: RecentPoses, pose_topic: str = POSE_TOPIC) -> Source:
    """Subscribe to a topic; the source gives the newest image, and skips those that it misses.

    Reading raises an InputError, with the cause, where images stop; read again for the next ones.

    Args:
        topic: of `sensor_msgs/Image`, or CompressedImage if it ends in /compressed.
        poses: take the poses of the robot, at their time of arrival.
        pose_topic: of `geometry_msgs/Transform`, mm.

    Raises:
        InputError: ROS is not installed, or this is no topic's name.
    """
    newest: Queue[Any] = Queue(1)
    ros = ros_here().beside("eyespot_console")
    from geometry_msgs.msg import Transform  # found by then in ROS 1, too
    from sensor_msgs import msg as sensor

    def put(image: Any, number: int) -> None:
        with suppress(Empty):
            newest.get_nowait()
        with suppress(Full):  # another publisher of the topic was faster
            newest.put_nowait(image)

    def take(message: Any, received_s: float) -> None:
        with suppress(InputError):  # what is no pose is left out, and the poses before it stay
            poses.take(message, received_s)

    name = ros.resolved(topic)
    ros.take_images(name, getattr(sensor, image_type(topic)), put)
    ros.take_poses(pose_topic, Transform, take)

    def read() -> Iterator[Frame]:
        silence = Silence(topic)
        index = 0
        while True:
            try:
                image = newest.get(timeout=PERIOD_S)
            except Empty:
                change = silence.change(lambda: ros.types_of(name))
                if change is not None and change[1]:
                    raise InputError(change[0]) from None
                continue
            silence.end()
            yield decoded_frame(image, index=index, time_s=ros.stamp_s(image))
            index += 1

    return Source(name=topic, read=read, live=True)
