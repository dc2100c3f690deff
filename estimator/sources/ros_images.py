"""Images of ROS messages as frames, and back; for bags and for a live node alike."""

from __future__ import annotations

from typing import Any, NamedTuple

import cv2
import numpy as np

from estimator.files import decoded_image
from estimator.image import checked_frame
from optics import InputError, in_file, shortened


class _Layout(NamedTuple):
    dtype: str
    channels: int
    to_rgb: int | None = None


_LAYOUTS = {
    "mono8": _Layout("u1", 1),
    "mono16": _Layout("u2", 1),
    "rgb8": _Layout("u1", 3),
    "rgb16": _Layout("u2", 3),
    "bgr8": _Layout("u1", 3, cv2.COLOR_BGR2RGB),
    "bgr16": _Layout("u2", 3, cv2.COLOR_BGR2RGB),
    "rgba8": _Layout("u1", 4, cv2.COLOR_RGBA2RGB),
    "bgra8": _Layout("u1", 4, cv2.COLOR_BGRA2RGB),
}


def frame_of_message(message: Any) -> np.ndarray:
    """The frame in a `sensor_msgs/Image` or `sensor_msgs/CompressedImage`.

    Args:
        message: with the fields of ROS 1 or ROS 2, as rospy, rclpy and rosbags give it.

    Returns:
        (H, W) or RGB (H, W, 3), uint8 or uint16.

    Raises:
        InputError: an encoding that is not an image's, or too few data for the image.
    """
    if hasattr(message, "format"):
        return _decompressed(np.frombuffer(message.data, np.uint8), message.format)
    layout = _LAYOUTS.get(message.encoding)
    if layout is None:
        raise InputError(
            f"the image encoding must be one of {', '.join(_LAYOUTS)};"
            f" got {shortened(message.encoding)}. Publish or convert it in one of these."
        )
    height, width, step = message.height, message.width, message.step
    values = np.dtype(layout.dtype).newbyteorder(">" if message.is_bigendian else "<")
    row = width * layout.channels * values.itemsize
    data = np.frombuffer(message.data, np.uint8)
    if step < row or data.size < height * step or row * height == 0:
        raise InputError(
            f"an image of {width}x{height} px ({message.encoding}, {step} bytes a row) cannot be"
            f" made of {data.size} bytes."
        )
    rows = np.ascontiguousarray(data[: height * step].reshape(height, step)[:, :row])
    image = rows.view(values).reshape(height, width, layout.channels)
    native = image.astype(values.newbyteorder("="), copy=False)
    return checked_frame(native if layout.to_rgb is None else cv2.cvtColor(native, layout.to_rgb))


def encoding_of(image: np.ndarray) -> str:
    """The encoding of a `sensor_msgs/Image` that contains a frame without loss.

    Raises:
        InputError: floats, for which ROS has no image encoding.
    """
    if image.dtype.name not in ("uint8", "uint16"):
        raise InputError(
            f"A ROS image holds uint8 or uint16; got {image.dtype.name}. Convert it with astype."
        )
    return ("mono" if image.ndim == 2 else "rgb") + str(8 * image.dtype.itemsize)


def _decompressed(data: np.ndarray, form: str) -> np.ndarray:
    with in_file(f"a compressed image ({shortened(form)}, {data.size} bytes) cannot be decoded"):
        return checked_frame(decoded_image(data.tobytes()).image)
