"""What the node and a topic of images need of ROS 1."""

import importlib
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, Self

from eyespot.estimator.rig.messages import PERIOD_S
from eyespot.estimator.rig.rig_reader import POSES_KEPT, Parameters
from eyespot.formats.inputs import InputError

_DEBIAN_PACKAGES = "/usr/lib/python3/dist-packages"  # rospy, outside of environments
# Larger than an uncompressed 1920x1080 RGB image (6.2 MB). In a smaller buffer old images wait, so
# that the next image is not the newest.
_BUFFER_BYTES = 2**25


class Ros1:
    """A node of ROS 1, whose callbacks run in threads of their own."""

    def __init__(self, name: str, **options: Any) -> None:
        # At the end of the path, so that it hides no package of the environment. The folders of a
        # ROS whose setup file was sourced come first.
        sys.path.append(_DEBIAN_PACKAGES)
        try:
            self._rospy = importlib.import_module("rospy")
        except ModuleNotFoundError as error:
            raise InputError(
                f"ROS is not installed: {error}. Source the setup file of your ROS (ROS 1, or ROS 2"
                " Jazzy or later), or run tools/install-ros for Debian's ROS 1."
            ) from error
        self._rospy.init_node(name, **options)

    @classmethod
    @contextmanager
    def running(cls, name: str) -> Iterator[Self]:
        """The node of a process of its own."""
        yield cls(name)

    @classmethod
    def beside(cls, name: str) -> Self:
        """A node of a process that ends by its own handlers of signals."""
        return cls(name, anonymous=True, disable_signals=True)

    def parameters(self) -> Parameters:
        """The node's parameters."""
        return Parameters.of(self._rospy.get_param("~", {}))

    def resolved(self, topic: str) -> str:
        """The whole name of a topic; ROS 1 writes ~name for what ROS 2 writes as ~/name."""
        return str(self._rospy.resolve_name(topic.replace("~/", "~", 1)))

    def publisher(self, topic: str, kind: Any) -> Any:
        """Publishes messages."""
        return self._rospy.Publisher(self.resolved(topic), kind, queue_size=10)

    def take_images(self, topic: str, kind: Any, take: Callable[[Any, int], None]) -> None:
        """Give each image with the number of its publisher; at most one waits for `take`."""
        self._rospy.Subscriber(
            topic,
            kind,
            lambda image: take(image, image.header.seq),
            queue_size=1,
            buff_size=_BUFFER_BYTES,
        )

    def take_poses(self, topic: str, kind: Any, take: Callable[[Any, float], None]) -> None:
        """Give each pose with the time of its arrival, s."""
        rospy = self._rospy
        rospy.Subscriber(
            self.resolved(topic),
            kind,
            lambda pose: take(pose, rospy.get_time()),
            queue_size=POSES_KEPT,
        )

    def stamp_s(self, image: Any) -> float:
        """Time stamp of an image, s; 0 if it has none."""
        return float(image.header.stamp.to_sec())

    def types_of(self, topic: str) -> list[str]:
        """The message types under which a topic is published."""
        return [kind for name, kind in self._rospy.get_published_topics() if name == topic]

    def say(self, text: str, *, is_fault: bool) -> None:
        """Log a message."""
        (self._rospy.logerr if is_fault else self._rospy.loginfo)(text)

    def spin(self, watch: Callable[[], None]) -> None:
        """Call `watch` every `PERIOD_S` until ROS shuts down."""
        while not self._rospy.is_shutdown():
            self._rospy.rostime.wallsleep(PERIOD_S)
            watch()
