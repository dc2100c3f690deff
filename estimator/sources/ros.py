"""ROS images: messages decoded, bags read and written.

Bags and a live node share the decoding. The encodings are those of sensor_msgs/image_encodings.hpp,
OpenCV's types in the order of channels of cv_bridge (BGR), and samples of 10, 12 and 14 bits in
words or packed: `p` is GenICam's packing, `packed` that of GigE Vision.
"""

import heapq
import logging
import math
import sys
from collections.abc import Iterable, Iterator
from dataclasses import replace
from functools import partial
from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import cv2
import numpy as np

from eyespot.estimator.frame_window import checked_frame
from eyespot.estimator.sources.source import Frame, Source
from eyespot.formats.image_files import decoded_image
from eyespot.formats.inputs import InputError, in_file, shortened
from eyespot.formats.poses import POSE_MESSAGES, POSE_TOPIC, Pose
from eyespot.formats.ros_bags import messages_of, opened_bag, stamp_s, topic_in
from eyespot.formats.whole_files import written_whole

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore


class _Layout(NamedTuple):
    dtype: str
    channels: int = 1
    to_rgb: int | None = None
    bits: int = 0  # of a sample; 0: all of its word
    packing: str = ""
    halves: int = 2  # as many halves of the image's rows make its rows of bytes


_MOSAICS = {
    "bayer_rggb": cv2.COLOR_BayerRGGB2RGB,
    "bayer_bggr": cv2.COLOR_BayerBGGR2RGB,
    "bayer_gbrg": cv2.COLOR_BayerGBRG2RGB,
    "bayer_grbg": cv2.COLOR_BayerGRBG2RGB,
}
_WHOLE = {
    "mono": _Layout("", 1),
    "rgb": _Layout("", 3),
    "bgr": _Layout("", 3, cv2.COLOR_BGR2RGB),
    "rgba": _Layout("", 4, cv2.COLOR_RGBA2RGB),
    "bgra": _Layout("", 4, cv2.COLOR_BGRA2RGB),
    **{name: _Layout("", 1, to_rgb) for name, to_rgb in _MOSAICS.items()},
}
_OPENCV = {"c1": "mono", "c3": "bgr", "c4": "bgra"}
_LAYOUTS = {
    **{f"{name}8": layout._replace(dtype="u1") for name, layout in _WHOLE.items()},
    **{f"{name}16": layout._replace(dtype="u2") for name, layout in _WHOLE.items()},
    **{f"8u{name}": _WHOLE[same]._replace(dtype="u1") for name, same in _OPENCV.items()},
    **{f"16u{name}": _WHOLE[same]._replace(dtype="u2") for name, same in _OPENCV.items()},
    **{
        f"{name}{bits}{packing}": _Layout("u2", 1, to_rgb, bits, packing)
        for name, to_rgb in ({"mono": None} | _MOSAICS).items()
        for bits, packings in ((10, ("", "p", "packed")), (12, ("", "p", "packed")), (14, ("",)))
        for packing in packings
    },
    **dict.fromkeys(("uyvy", "yuv422"), _Layout("u1", 2, cv2.COLOR_YUV2RGB_UYVY)),
    **dict.fromkeys(("yuyv", "yuv422_yuy2"), _Layout("u1", 2, cv2.COLOR_YUV2RGB_YUY2)),
    "nv12": _Layout("u1", to_rgb=cv2.COLOR_YUV2RGB_NV12, halves=3),
    "nv21": _Layout("u1", to_rgb=cv2.COLOR_YUV2RGB_NV21, halves=3),
    "nv24": _Layout("u1", to_rgb=cv2.COLOR_YUV2RGB_UYVY, halves=6),
    "16sc1": _Layout("i2", bits=15),
    "32fc1": _Layout("f4"),
    "64fc1": _Layout("f8"),
}


def frame_of_message(message: Any) -> tuple[np.ndarray, float | None]:
    """The frame in a `sensor_msgs/Image` or `sensor_msgs/CompressedImage`, and its full scale.

    Args:
        message: with the fields of ROS 1 or ROS 2, as rospy, rclpy and rosbags give it.

    Returns:
        (H, W) or RGB (H, W, 3), uint8, uint16, float32 or float64; and the value at which its
        samples end, None if the encoding does not say it.

    Raises:
        InputError: an encoding that is not an image's, or too few data for the image.
    """
    if hasattr(message, "format"):
        return _decompressed(np.frombuffer(message.data, np.uint8), message.format)
    layout = _LAYOUTS.get(message.encoding.lower())
    if layout is None:
        raise InputError(
            "the image encoding must be mono or bayer_* with 8, 10, 12, 14 or 16 bits (10 and 12 "
            "also p or packed), rgb, bgr, rgba or bgra with 8 or 16, uyvy, yuyv, yuv422, "
            "yuv422_yuy2, nv12, nv21, nv24, 8UC1, 8UC3, 8UC4, 16UC1, 16UC3, 16UC4, 16SC1, 32FC1 or "
            f"64FC1; got {shortened(message.encoding)}. Record or convert it in one of these."
        )
    samples, bits = _samples(message, layout)
    if layout.halves == 6:  # OpenCV lacks NV24: every pixel as two of UYVY
        y, uv = np.split(samples, [message.height])
        u, v = np.moveaxis(uv.reshape(*y.shape, 2), 2, 0)
        samples = np.stack([u, y, v, y], axis=2).reshape(message.height, -1, 2)
    try:
        image = samples if layout.to_rgb is None else cv2.cvtColor(samples, layout.to_rgb)
    except cv2.error as error:
        raise InputError(
            f"{message.encoding} has colours of pairs of pixels, but the image has {message.width}x"
            f"{message.height} px. Record it with an even width and height."
        ) from error
    if layout.halves == 6:
        image = np.ascontiguousarray(image[:, ::2])
    return checked_frame(image), _full_scale(image, bits)


def decoded_frame(message: Any, *, index: int, time_s: float) -> Frame:
    """The frame of a message; one that cannot be decoded says why, see `frame_of_message`."""
    try:
        image, full_scale = frame_of_message(message)
    except InputError as error:
        return Frame(index=index, time_s=time_s, fault=f"{error}")
    return Frame(index=index, time_s=time_s, image=image, full_scale=full_scale)


def _samples(message: Any, layout: _Layout) -> tuple[np.ndarray, int]:
    """The samples in native words, and how many of their bits are used; 0: all."""
    data = np.frombuffer(message.data, np.uint8)
    height, width, step = message.height * layout.halves // 2, message.width, message.step
    if layout.halves > 2 and data.size == height * width:
        step = width  # some drivers count the bytes of the other planes as well
    values = np.dtype(layout.dtype).newbyteorder(">" if message.is_bigendian else "<")
    row, bits, packings = width * layout.channels * values.itemsize, layout.bits, [layout.packing]
    triples = -(-width // 2)
    in_words = values.kind == "u" and values.itemsize == 2 and layout.channels == 1
    if packings == [""] and in_words and bits in (0, 12) and 3 * triples <= step < row:
        bits, packings = 12, ["packed", "p"]  # avt_vimba_camera gives them the name of words
    if packings[0]:
        row = 3 * triples if packings[0] == "packed" else -(-width * bits // 8)
    if step < row or data.size < height * step or row * height == 0:
        raise InputError(
            f"an image of {message.width}x{message.height} px ({message.encoding}, {message.step} "
            f"bytes a row) cannot be made of {data.size} bytes."
        )
    rows = np.ascontiguousarray(data[: height * step].reshape(height, step)[:, :row])
    if packings[0]:
        found = [_unpacked(rows, width, bits, packing) for packing in packings]
        # Unpacked in the wrong way, neighbours have nothing in common.
        return min(found, key=lambda one: np.abs(np.diff(one[::8].astype(int))).sum()), bits
    shape = (height, width) if layout.channels == 1 else (height, width, layout.channels)
    image = rows.view(values).reshape(shape).astype(values.newbyteorder("="), copy=False)
    if values.kind != "i":
        return image, bits
    if image.min() < 0:
        raise InputError(
            f"an image of {message.encoding} has values below 0 (down to {image.min()}), which no "
            "light has. Record it as 16UC1."
        )
    return image.astype(np.uint16), bits


def _unpacked(rows: np.ndarray, width: int, bits: int, packing: str) -> np.ndarray:
    """The samples in rows of packed bytes, (H, W)."""
    rows, number = rows.astype(np.uint16), np.arange(width)
    if packing == "p":  # one stream of bits, the lowest first
        first, shift = number * bits // 8, (number * bits % 8).astype(np.uint16)
        return (rows[:, first] | rows[:, first + 1] << 8) >> shift & (2**bits - 1)
    # Of two samples in three bytes, the middle byte has the low bits, from its bits 0 and 4 on.
    pair, second = number // 2 * 3, number % 2
    low = rows[:, pair + 1] >> (4 * second).astype(np.uint16) & (2 ** (bits - 8) - 1)
    return rows[:, pair + 2 * second] << (bits - 8) | low


def _full_scale(image: np.ndarray, bits: int) -> float | None:
    """None also if only the name has these bits, as of a JPEG, or if they are the upper ones."""
    said = bits and image.dtype == np.uint16 and image.max() < 2**bits
    return float(2**bits - 1) if said else None


def _decompressed(data: np.ndarray, form: str) -> tuple[np.ndarray, float | None]:
    """The image of a format such as "bayer_rggb8; png compressed " or "rgb8; jpeg compressed bgr8".

    The last word is what was compressed; without it, a mosaic still is one.
    """
    if "compressedDepth" in form:
        raise InputError(
            f"{shortened(form)} is an image of depths, not of light. Name another topic."
        )
    layout = _LAYOUTS.get(form.partition(";")[0].strip().lower(), _Layout("u1"))
    was_converted = form.rpartition("compressed")[2].strip().startswith(("mono", "rgb", "bgr"))
    is_mosaic = layout.to_rgb in _MOSAICS.values() and not was_converted
    with in_file(f"a compressed image ({shortened(form)}, {data.size} bytes) cannot be decoded"):
        found = decoded_image(data.tobytes())
        image = found.image
        if is_mosaic and image.ndim == 2 and layout.to_rgb is not None:
            image = cv2.cvtColor(image, layout.to_rgb)
        return checked_frame(image), found.full_scale or _full_scale(image, layout.bits)


IMAGE_TOPIC = "/decklink/camera/image_raw"
"""The rig's topic of microscope images."""
IMAGE_MESSAGES = ("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage")
"""Message types that contain an image."""

_log = logging.getLogger("eyespot")
_BACKWARDS = (
    "%s, %s: the stamp of frame %d, %.6f s, is earlier than one before it, %.6f s. Frames keep the "
    "order of their arrival, and get the robot's pose at their own stamp."
)
_UNREADABLE = "%s, %s: %d of %d images could not be decoded, and have no spot. %s"


def open_bag(path: Path, *, topic: str | None = None) -> Source:
    """The images of a bag as a source, in the order of their arrival.

    A frame has the time of its header, or of its arrival if the header has none; s since ROS's
    epoch. An image that cannot be decoded is a black frame with a fault. How many there are is
    logged at the end, and the first stamp that is earlier than one before it.

    Args:
        topic: of the images, raw or compressed; None takes `IMAGE_TOPIC`, or the only one.

    Raises:
        InputError: not a bag, or without such a topic or any images. Reading raises it for damage,
            or where no image can be decoded.
    """
    with opened_bag(path) as reader:
        name = topic_in(reader, path, topic, kinds=IMAGE_MESSAGES, usual=IMAGE_TOPIC)
        length = reader.topics[name].msgcount
    if not length:
        raise InputError(f"{path}: {name} holds no images. Check that it is the right bag.")

    def read() -> Iterator[Frame]:
        waiting: list[Frame] = []  # until one can be decoded, which says their size
        number, broken, first, latest_s = 0, 0, "", -math.inf
        try:
            with opened_bag(path) as reader:
                for number, (received_s, message) in enumerate(messages_of(reader, path, name), 1):
                    if isinstance(message, InputError):
                        frame = Frame(index=number - 1, time_s=received_s, fault=f"{message}")
                    else:
                        time_s = stamp_s(message.header) or received_s
                        frame = decoded_frame(message, index=number - 1, time_s=time_s)
                    if frame.time_s < latest_s < math.inf:
                        _log.warning(_BACKWARDS, path, name, frame.index, frame.time_s, latest_s)
                        latest_s = math.inf  # said once
                    latest_s = max(frame.time_s, latest_s)
                    waiting.append(frame)
                    if frame.fault:
                        broken += 1
                        first = first or (
                            f"The first, frame {frame.index}: {frame.fault.rstrip('.')}."
                        )
                    else:
                        seen = frame.image
                    if broken < number:
                        for one in waiting:
                            yield replace(one, image=np.zeros_like(seen)) if one.fault else one
                        waiting.clear()
            if waiting:
                raise InputError(
                    f"{path}, {name}: none of {number} images can be decoded. {first} Record "
                    "again in another encoding, or name another topic."
                )
        finally:
            if 0 < broken < number:
                _log.warning(_UNREADABLE, path, name, broken, number, first)

    return Source(name=str(path), read=read, length=length, poses_file=path)


def write_bag(
    path: str | Path,
    *,
    frames: Iterable[Frame | Pose],
    poses: Iterable[Pose] = (),
    ros: Literal[1, 2] = 1,
) -> None:
    """Write a bag with the rig's topics, playable with `rosbag play` or `ros2 bag play`.

    Images are `sensor_msgs/Image` (rgb8, mono8, rgb16 or mono16) with `header.stamp` and, in ROS 1,
    `header.seq` from the frame's time and index; poses are `geometry_msgs/Transform` in mm. Every
    message arrives at its own time, in the order of time. Neither input is kept in memory as a
    whole.

    Args:
        path: of the bag, `NAME.bag`, or for ROS 2 the folder, which holds an MCAP file; must not
            exist.
        frames, poses: in the order of time; frames may have poses between them.

    Raises:
        InputError: the file exists, a time is not positive (ROS reads 0 as no time: add an
            offset to frames and poses alike), or an image is of floats.
    """
    from rosbags import rosbag1, rosbag2
    from rosbags.typesys import Stores, get_typestore

    newest, mcap = rosbag2.Writer.VERSION_LATEST, rosbag2.StoragePlugin.MCAP
    of_ros2 = partial(rosbag2.Writer, version=newest, storage_plugin=mcap)
    opened: Any = rosbag1.Writer if ros == 1 else of_ros2
    types = get_typestore(Stores.ROS1_NOETIC if ros == 1 else Stores.ROS2_HUMBLE)
    to_bytes = types.serialize_ros1 if ros == 1 else types.serialize_cdr
    # ROS 2 names the file inside a bag after the bag; here both have the bag's own name already.
    with written_whole(Path(path)) as whole, opened(whole) as writer:
        image_connection = writer.add_connection(IMAGE_TOPIC, IMAGE_MESSAGES[0], typestore=types)
        pose_connection = writer.add_connection(POSE_TOPIC, POSE_MESSAGES[0], typestore=types)
        in_time: Any = heapq.merge(frames, poses, key=attrgetter("time_s"))
        for item in in_time:
            if not item.time_s >= 1e-9:
                raise InputError(
                    f"A bag's times must be positive, because ROS reads 0 as no time; got "
                    f"{item.time_s} s. Add one offset to the times of frames and poses."
                )
            time_ns = round(item.time_s * 1e9)
            if isinstance(item, Pose):
                connection, message = pose_connection, _transform(item, types)
            else:
                connection, message = image_connection, _image_message(item, time_ns, types)
            writer.write(connection, time_ns, to_bytes(message, connection.msgtype))


def _image_message(frame: Frame, time_ns: int, types: "Typestore") -> Any:
    made = types.types
    image = np.ascontiguousarray(checked_frame(frame.image))
    if image.dtype.name not in ("uint8", "uint16"):
        raise InputError(
            f"a bag holds images of 8 or 16 bits; got {image.dtype.name}. Convert them, or record "
            "the spots alone (.csv)."
        )
    seconds, nanoseconds = divmod(time_ns, 10**9)
    stamp = made["builtin_interfaces/msg/Time"](sec=seconds, nanosec=nanoseconds)
    header: Any = made["std_msgs/msg/Header"]
    number = {"seq": frame.index} if "seq" in header.__dataclass_fields__ else {}
    return made[IMAGE_MESSAGES[0]](
        header=header(stamp=stamp, frame_id="microscope", **number),
        height=image.shape[0],
        width=image.shape[1],
        encoding=("mono" if image.ndim == 2 else "rgb") + str(8 * image.dtype.itemsize),
        is_bigendian=sys.byteorder == "big",
        step=image.strides[0],
        data=image.reshape(-1).view(np.uint8),
    )


def _transform(pose: Pose, types: "Typestore") -> Any:
    made = types.types
    x, y, z = pose.position_mm
    qx, qy, qz, qw = pose.rotation
    return made[POSE_MESSAGES[0]](
        translation=made["geometry_msgs/msg/Vector3"](x=x, y=y, z=z),
        rotation=made["geometry_msgs/msg/Quaternion"](x=qx, y=qy, z=qz, w=qw),
    )
