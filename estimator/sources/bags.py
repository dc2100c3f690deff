"""ROS 1 and ROS 2 bags, read and written without ROS.

Topics of the rig: the microscope's image, and the pose of the instrument's tip, a
`geometry_msgs/Transform` in mm that carries no time stamp of its own.
"""

from __future__ import annotations

import heapq
import itertools
import os
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from functools import partial
from operator import attrgetter
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, cast

import numpy as np

from estimator.files import Pose, damage_told
from estimator.image import checked_frame
from estimator.sources.ros_images import encoding_of, frame_of_message
from estimator.sources.source import Frame, Source

if TYPE_CHECKING:
    from rosbags.highlevel import AnyReader
    from rosbags.typesys.store import Typestore

IMAGE_TOPIC = "/decklink/camera/image_raw"
POSE_TOPIC = "/eye_robot/FrameEE"

_IMAGES = ("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage")
_REMEDY = (
    "A bag that was cut short is mended by `rosbag reindex`, `ros2 bag reindex` or `mcap recover`."
)
_POSES = ("geometry_msgs/msg/Transform", "geometry_msgs/msg/PoseStamped")


def is_bag(path: Path) -> bool:
    """Whether a path is a ROS 1 bag, or a ROS 2 bag: a folder, or its file alone."""
    return (path / "metadata.yaml").is_file() or path.suffix in (".bag", ".db3", ".mcap")


def open_bag(path: Path, *, topic: str | None = None) -> Source:
    """The images of a bag as a source.

    Raises:
        ValueError: as `read_frames`, and where there are none.
    """
    with _opened(path) as reader:
        topic = _topic(reader, path, topic, _IMAGES, IMAGE_TOPIC)
        length = reader.topics[topic].msgcount
    if not length:
        raise ValueError(f"{path}: {topic} holds no images. Check that it is the right bag.")
    return Source(name=str(path), read=partial(read_frames, path, topic=topic), length=length)


def read_frames(path: Path, *, topic: str | None = None) -> Iterator[Frame]:
    """Read the images of a bag, one at a time.

    Args:
        path: of the bag.
        topic: of the images, raw or compressed; None takes `IMAGE_TOPIC`, or the only one.

    Yields:
        Frames with the time of their header, or of their arrival where the header has none; s
        since ROS's epoch.

    Raises:
        ValueError: no bag, damaged, without such a topic, or an image that cannot be decoded.
    """
    with _opened(path) as reader:
        topic = _topic(reader, path, topic, _IMAGES, IMAGE_TOPIC)
        for index, (received, message) in enumerate(_messages(reader, path, topic)):
            try:
                image = frame_of_message(message)
            except ValueError as error:
                raise ValueError(f"{path}, {topic}, frame {index}: {error}") from error
            time_s = _stamped(message.header) or received
            yield Frame(index=index, file_name="", time_s=time_s, image=image)


def read_poses(path: Path, *, topic: str | None = None) -> Iterator[Pose]:
    """Read the poses of a bag.

    A `Transform` is in mm and bears the time of its arrival; a `PoseStamped` is in m and bears
    the time of its header.

    Args:
        path: of the bag.
        topic: of the poses; None takes `POSE_TOPIC`, or the only one.

    Raises:
        ValueError: no bag, damaged, without such a topic, or a message that is no pose.
    """
    with _opened(path) as reader:
        topic = _topic(reader, path, topic, _POSES, POSE_TOPIC)
        for index, (received, message) in enumerate(_messages(reader, path, topic)):
            try:
                yield _pose(message, received)
            except ValueError as error:
                raise ValueError(f"{path}, {topic}, message {index}: {error}") from error


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

    Images are `sensor_msgs/Image` (rgb8, mono8, rgb16 or mono16) with `header.stamp` and, in
    ROS 1, `header.seq` from the frame's time and index; poses are `geometry_msgs/Transform` in mm.
    Both are received at their own time, in the order of time. Neither input is held in memory as a
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
        ValueError: the file exists, a time is not positive (ROS reads 0 as no time: add an
            offset to frames and poses alike), or an image is of floats.
    """
    path = Path(path)
    if path.exists():
        raise ValueError(f"{path} exists already. Choose another name or remove it.")
    version = _ros(ros)
    # ROS 2 names the file inside a bag after the bag: it is written elsewhere, not otherwise named.
    with TemporaryDirectory(prefix=f".{path.name}.", dir=path.parent) as elsewhere:
        whole = Path(elsewhere) / path.name
        with version.open(whole) as writer:
            types = version.types
            image_connection = writer.add_connection(image_topic, _IMAGES[0], typestore=types)
            pose_connection = writer.add_connection(pose_topic, _POSES[0], typestore=types)
            in_time = cast(
                Iterator[Frame | Pose], heapq.merge(frames, poses, key=attrgetter("time_s"))
            )
            for item in in_time:
                time_ns = _nanoseconds(item.time_s)
                if isinstance(item, Pose):
                    connection, message = pose_connection, _transform(item, types)
                else:
                    connection, message = image_connection, _image_message(item, time_ns, types)
                writer.write(connection, time_ns, version.bytes_of(message, connection.msgtype))
        os.replace(whole, path)


class _Ros(NamedTuple):
    """How a version of ROS writes bags."""

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


@contextmanager
def _opened(path: Path) -> Iterator[AnyReader]:
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    # Old ROS 2 bags hold no definitions; those of the messages used here have never changed.
    types = get_typestore(Stores.ROS2_HUMBLE)
    with damage_told(f"{path}", _REMEDY):
        reader = AnyReader([path], default_typestore=types)
        reader.open()
    try:
        yield reader
    finally:
        reader.close()


def _topic(
    reader: AnyReader, path: Path, name: str | None, kinds: tuple[str, ...], usual: str
) -> str:
    """The topic that was asked for, or the usual one, or the only one of these kinds."""
    found = sorted(t for t, info in reader.topics.items() if info.msgtype in kinds)
    wanted = name or (usual if usual in found else None)
    if wanted is None and len(found) == 1:
        return found[0]
    if wanted in found:
        return wanted
    sort = kinds[0].rpartition("/")[2].lower()
    asked = f"no topic {name} of" if name else "no one topic of" if found else "no topic of"
    choice = f"Choose one of {', '.join(found)}." if found else "Check that it is the right bag."
    raise ValueError(f"{path} holds {asked} {' or '.join(kinds)} for the {sort}s. {choice}")


def _messages(reader: AnyReader, path: Path, topic: str) -> Iterator[tuple[float, Any]]:
    """Time of arrival, s, and content of each message of a topic, in the order of arrival."""
    messages = reader.messages([c for c in reader.connections if c.topic == topic])
    for index in itertools.count():
        with damage_told(f"{path}, {topic}, message {index}", _REMEDY):
            item = next(messages, None)
            if item is None:
                return
            connection, time_ns, data = item
            message = reader.deserialize(data, connection.msgtype)
        yield time_ns / 1e9, message


def _stamped(header: Any) -> float:
    """A header's time, s; 0 where it has none."""
    return (header.stamp.sec * 10**9 + header.stamp.nanosec) / 1e9


def _pose(message: Any, received: float) -> Pose:
    if hasattr(message, "translation"):
        time_s, scale = received, 1.0
        position, turn = message.translation, message.rotation
    else:
        time_s, scale = _stamped(message.header) or received, 1e3
        position, turn = message.pose.position, message.pose.orientation
    return Pose(
        time_s=time_s,
        position_mm=(scale * position.x, scale * position.y, scale * position.z),
        rotation=(turn.x, turn.y, turn.z, turn.w),
    )


def _nanoseconds(time_s: float) -> int:
    if not time_s >= 1e-9:
        raise ValueError(
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
    return made[_IMAGES[0]](
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
    return made[_POSES[0]](
        translation=made["geometry_msgs/msg/Vector3"](x=x, y=y, z=z),
        rotation=made["geometry_msgs/msg/Quaternion"](x=qx, y=qy, z=qz, w=qw),
    )
