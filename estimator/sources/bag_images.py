"""The images of ROS 1 and ROS 2 bags as a source, read without ROS."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from pathlib import Path

from estimator.files import messages_of, opened_bag, stamp_s, topic_in
from estimator.sources.ros_images import frame_of_message
from estimator.sources.source import Frame, Source
from optics import InputError

IMAGE_TOPIC = "/decklink/camera/image_raw"
"""The rig's topic of microscope images."""
IMAGE_MESSAGES = ("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage")
"""Message types that contain an image."""


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
    """Read the images of a bag, one at a time.

    Args:
        path: of the bag.
        topic: of the images, raw or compressed; None takes `IMAGE_TOPIC`, or the only one.

    Yields:
        Frames with the time of their header, or of their arrival if the header has none; s since
        ROS's epoch.

    Raises:
        InputError: not a bag, damaged, without such a topic, or an image cannot be decoded.
    """
    with opened_bag(path) as reader:
        topic = topic_in(reader, path, topic, kinds=IMAGE_MESSAGES, usual=IMAGE_TOPIC)
        for index, (received_s, message) in enumerate(messages_of(reader, path, topic)):
            try:
                image = frame_of_message(message)
            except InputError as error:
                raise InputError(f"{path}, {topic}, frame {index}: {error}") from error
            time_s = stamp_s(message.header) or received_s
            yield Frame(index=index, file_name="", time_s=time_s, image=image)
