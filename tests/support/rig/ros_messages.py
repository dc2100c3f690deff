"""Messages of ROS 1 and ROS 2 laid out by hand, and bags of them, by rosbags alone."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from rosbags import rosbag1, rosbag2
from rosbags.typesys import Stores, get_typestore

EPOCH_S = 1.6e9

ROS1 = get_typestore(Stores.ROS1_NOETIC)
ROS2 = get_typestore(Stores.ROS2_HUMBLE)


def message(types: Any, kind: str, **content: Any) -> Any:
    return types.types[kind](**content)


def header(types: Any, time_s: float) -> Any:
    seconds, nanoseconds = divmod(round(time_s * 1e9), 10**9)
    stamp = message(types, "builtin_interfaces/msg/Time", sec=seconds, nanosec=nanoseconds)
    content = {"stamp": stamp, "frame_id": ""} | ({"seq": 0} if types is ROS1 else {})
    return message(types, "std_msgs/msg/Header", **content)


def image_message(
    types: Any, image: np.ndarray, encoding: str, time_s: float = EPOCH_S, padding: int = 0
) -> Any:
    """A message whose bytes are laid out by hand, rows padded as cameras pad them."""
    height = image.shape[0]
    rows = np.ascontiguousarray(image).view(np.uint8).reshape(height, -1)
    padded = np.pad(rows, ((0, 0), (0, padding)), constant_values=77)
    return message(
        types,
        "sensor_msgs/msg/Image",
        header=header(types, time_s),
        height=height,
        width=image.shape[1],
        encoding=encoding,
        is_bigendian=int(image.dtype.byteorder == ">"),
        step=padded.shape[1],
        data=padded.ravel(),
    )


def compressed_message(types: Any, image: np.ndarray, form: str = "png") -> Any:
    colours = image[:, :, ::-1] if image.ndim == 3 else image
    written, data = cv2.imencode(f".{form}", colours)
    assert written
    return message(
        types,
        "sensor_msgs/msg/CompressedImage",
        header=header(types, EPOCH_S),
        format=form,
        data=data,
    )


def write(path: Path, types: Any, messages: list[tuple[str, float, Any]], **options: Any) -> Path:
    """A bag of (topic, time of arrival, message), by rosbags alone."""
    writers: dict[Any, Callable[..., Any]] = {ROS1: rosbag1.Writer, ROS2: rosbag2.Writer}
    serialize = types.serialize_ros1 if types is ROS1 else types.serialize_cdr
    with writers[types](path, **options) as writer:
        connections: dict[str, Any] = {}
        for topic, time_s, content in messages:
            kind = content.__msgtype__
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=types)
            writer.write(connections[topic], round(time_s * 1e9), serialize(content, kind))
    return path
