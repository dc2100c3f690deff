"""Notices when images stop, says why as far as topics show it, and notices when they are back."""

from __future__ import annotations

import time
from collections.abc import Callable, Collection

PERIOD_S = 1.0  # how often a node should look
_LIMIT_S = 2.0  # a rig's camera takes 20 images in this time


def image_type(topic: str) -> str:
    """Name of the messages of an image topic; image_transport's ends in /compressed."""
    return "CompressedImage" if topic.endswith("/compressed") else "Image"


class Silence:
    """The time since the last image of a topic.

    Args:
        topic: of the images.
        clock: s; does not jump.
    """

    def __init__(self, topic: str, clock: Callable[[], float] = time.monotonic) -> None:
        self._topic, self._clock = topic, clock
        self._last_s = clock()
        self._said = ""

    def end(self) -> None:
        """An image has arrived."""
        self._last_s = self._clock()

    def change(self, types: Callable[[], Collection[str]]) -> tuple[str, bool] | None:
        """What has changed since the last call, if anything.

        Args:
            types: finds the message types under which the topic is published at this moment.

        Returns:
            A message, and whether it is about a fault; None if all is as it was.
        """
        seconds = self._clock() - self._last_s
        if seconds > _LIMIT_S:
            said = f"no image on {self._topic}: {self._cause(types())}"
            changed, self._said = said != self._said, said
            return (said, True) if changed else None
        changed, self._said = self._said != "", ""
        return (f"images arrive on {self._topic}.", False) if changed else None

    @property
    def said(self) -> str:
        """What is wrong at this moment; empty if images arrive."""
        return self._said

    def _cause(self, types: Collection[str]) -> str:
        found = {name.replace("/msg/", "/") for name in types}  # as ROS 1 writes them
        wanted = f"sensor_msgs/{image_type(self._topic)}"
        if not found:
            return (
                "nobody publishes it. Check the camera's node and cable, and the parameter "
                "image_topic."
            )
        if wanted not in found:
            return (
                f"it is published as {', '.join(sorted(found))}, and a topic of this name is read "
                f"as {wanted}. Choose one of raw images, or one that ends in /compressed."
            )
        return (
            "it is published, but nothing arrives. Check the camera; in ROS 2 also the quality of"
            " service (ros2 topic info --verbose)."
        )
