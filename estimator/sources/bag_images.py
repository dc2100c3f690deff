"""The images of ROS 1 and ROS 2 bags as a source, read without ROS."""

from __future__ import annotations

import logging
import math
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from estimator.files import messages_of, opened_bag, stamp_s, topic_in
from estimator.sources.ros_images import decoded_frame
from estimator.sources.source import Frame, Source
from optics import InputError

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
    """The images of a bag as a source.

    Raises:
        InputError: as `read_frames`, or the bag has no images.
    """
    with opened_bag(path) as reader:
        topic = topic_in(reader, path, topic, kinds=IMAGE_MESSAGES, usual=IMAGE_TOPIC)
        length = reader.topics[topic].msgcount
    if not length:
        raise InputError(f"{path}: {topic} holds no images. Check that it is the right bag.")
    return Source(name=str(path), read=partial(read_frames, path, topic=topic), length=length)


def read_frames(path: Path, *, topic: str | None = None) -> Iterator[Frame]:
    """Read the images of a bag, one at a time, in the order of their arrival.

    An image that cannot be decoded is a black frame with a fault. How many there are is logged at
    the end, and the first stamp that is earlier than one before it.

    Args:
        path: of the bag.
        topic: of the images, raw or compressed; None takes `IMAGE_TOPIC`, or the only one.

    Yields:
        Frames with the time of their header, or of their arrival if the header has none; s since
        ROS's epoch.

    Raises:
        InputError: not a bag, damaged, without such a topic, or no image can be decoded.
    """
    waiting: list[Frame] = []  # until one can be decoded, which says their size
    number, broken, first, latest_s = 0, 0, "", -math.inf
    with opened_bag(path) as reader:
        topic = topic_in(reader, path, topic, kinds=IMAGE_MESSAGES, usual=IMAGE_TOPIC)
        try:
            for number, (received_s, message) in enumerate(messages_of(reader, path, topic), 1):
                if isinstance(message, InputError):
                    frame = Frame.unreadable(number - 1, received_s, f"{message}")
                else:
                    time_s = stamp_s(message.header) or received_s
                    frame = decoded_frame(message, index=number - 1, time_s=time_s)
                if frame.time_s < latest_s < math.inf:
                    _log.warning(_BACKWARDS, path, topic, frame.index, frame.time_s, latest_s)
                    latest_s = math.inf  # said once
                latest_s = max(frame.time_s, latest_s)
                waiting.append(frame)
                if frame.fault:
                    broken += 1
                    first = first or f"The first, frame {frame.index}: {frame.fault.rstrip('.')}."
                else:
                    seen = frame.image
                if broken < number:
                    for one in waiting:
                        yield replace(one, image=np.zeros_like(seen)) if one.fault else one
                    waiting.clear()
            if waiting:
                raise InputError(
                    f"{path}, {topic}: none of {number} images can be decoded. {first} Record "
                    "again in another encoding, or name another topic."
                )
        finally:
            if 0 < broken < number:
                _log.warning(_UNREADABLE, path, topic, broken, number, first)
