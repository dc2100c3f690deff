"""Writes ROS 1 and ROS 2 bags with the rig's topics, without ROS."""

from __future__ import annotations

import heapq
import sys
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, cast

import numpy as np

from estimator.files import POSE_MESSAGES, POSE_TOPIC, Pose, written_whole
from estimator.image import checked_frame
from estimator.sources.bag_images import IMAGE_MESSAGES, IMAGE_TOPIC
from estimator.sources.ros_images import encoding_of
from estimator.sources.source import Frame
from optics import InputError

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore


def write_bag(
    path: str | Path,
    *,
    frames: Iterable[Frame],
    poses: Iterable[Pose],
    ros: Literal[1, 2] = 1,
    image_topic: str = IMAGE_TOPIC,
    pose_topic: str = POSE_TOPIC,
) -> None:
    """Write a bag with the rig's topics, playable with `rosbag play` or `ros2 bag play`.

    Images are `sensor_msgs/Image` (rgb8, mono8, rgb16 or mono16) with `header.stamp` and, in ROS 1,
    `header.seq` from the frame's time and index; poses are `geometry_msgs/Transform` in mm. Every
    message arrives at its own time, in the order of time. Neither input is kept in memory as a
    whole.

    Args:
        path: of the bag, `NAME.bag`, or for ROS 2 the folder, which holds an MCAP file; must not
            exist.
        frames: in the order of time.
        poses: in the order of time.
        ros: version of ROS.
        image_topic: name of the images' topic.
        pose_topic: name of the poses' topic.

    Raises:
        InputError: the file exists, a time is not positive (ROS reads 0 as no time: add an
            offset to frames and poses alike), or an image is of floats.
    """
    in_time = cast(Iterator[Frame | Pose], heapq.merge(frames, poses, key=attrgetter("time_s")))
    write_messages(path, in_time, ros=ros, image_topic=image_topic, pose_topic=pose_topic)


def write_messages(
    path: str | Path,
    messages: Iterable[Frame | Pose],
    *,
    ros: Literal[1, 2] = 1,
    image_topic: str = IMAGE_TOPIC,
    pose_topic: str = POSE_TOPIC,
) -> None:
    """Write a bag of frames and poses that come in the order of time, as `write_bag`."""
    path = Path(path)
    version = _ros(ros)
    # ROS 2 names the file inside a bag after the bag; here both have the bag's own name already.
    with written_whole(path) as whole, version.open(whole) as writer:
        types = version.types
        image_connection = writer.add_connection(image_topic, IMAGE_MESSAGES[0], typestore=types)
        pose_connection = writer.add_connection(pose_topic, POSE_MESSAGES[0], typestore=types)
        for item in messages:
            time_ns = _nanoseconds(item.time_s)
            if isinstance(item, Pose):
                connection, message = pose_connection, _transform(item, types)
            else:
                connection, message = image_connection, _image_message(item, time_ns, types)
            writer.write(connection, time_ns, version.bytes_of(message, connection.msgtype))


class _Ros(NamedTuple):
    """Types and writer of a version of ROS."""

    types: Typestore
    open: Callable[[Path], Any]
    bytes_of: Callable[[Any, str], memoryview]


def _ros(version: Literal[1, 2]) -> _Ros:
    from rosbags import rosbag1, rosbag2
    from rosbags.typesys import Stores, get_typestore

    if version == 1:
        types = get_typestore(Stores.ROS1_NOETIC)
        return _Ros(types, rosbag1.Writer, types.serialize_ros1)
    types = get_typestore(Stores.ROS2_HUMBLE)
    mcap = partial(
        rosbag2.Writer,
        version=rosbag2.Writer.VERSION_LATEST,
        storage_plugin=rosbag2.StoragePlugin.MCAP,
    )
    return _Ros(types, mcap, types.serialize_cdr)


def _nanoseconds(time_s: float) -> int:
    if not time_s >= 1e-9:
        raise InputError(
            f"A bag's times must be positive, because ROS reads 0 as no time; got {time_s} s."
            " Add one offset to the times of frames and poses."
        )
    return round(time_s * 1e9)


def _image_message(frame: Frame, time_ns: int, types: Typestore) -> Any:
    made = types.types
    image = np.ascontiguousarray(checked_frame(frame.image))
    seconds, nanoseconds = divmod(time_ns, 10**9)
    stamp = made["builtin_interfaces/msg/Time"](sec=seconds, nanosec=nanoseconds)
    header: Any = made["std_msgs/msg/Header"]
    number = {"seq": frame.index} if "seq" in header.__dataclass_fields__ else {}
    return made[IMAGE_MESSAGES[0]](
        header=header(stamp=stamp, frame_id="microscope", **number),
        height=image.shape[0],
        width=image.shape[1],
        encoding=encoding_of(image),
        is_bigendian=sys.byteorder == "big",
        step=image.strides[0],
        data=image.reshape(-1).view(np.uint8),
    )


def _transform(pose: Pose, types: Typestore) -> Any:
    made = types.types
    x, y, z = pose.position_mm
    qx, qy, qz, qw = pose.rotation
    return made[POSE_MESSAGES[0]](
        translation=made["geometry_msgs/msg/Vector3"](x=x, y=y, z=z),
        rotation=made["geometry_msgs/msg/Quaternion"](x=qx, y=qy, z=qz, w=qw),
    )
