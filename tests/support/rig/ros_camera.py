"""A program: a camera on a ROS topic that is twice as fast as its reader, and the reader's answers.

    python tests/support/rig/ros_camera.py ANSWERS.json SECONDS

First it finds how fast the node reads, then it publishes at twice that rate. A line of the answers
is the number of the image, the seconds from its publication to its status, and the node's counts.
"""

import json
import sys
import time
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np

sys.path.append("/usr/lib/python3/dist-packages")
import rospy
from diagnostic_msgs.msg import DiagnosticArray
from sensor_msgs.msg import Image
from std_msgs.msg import Header

IMAGE_TOPIC, STATUS_TOPIC = "/decklink/camera/image_raw", "/eyespot/status"


def images() -> list[bytes]:
    """A disc at two places, too far apart to be followed: each image is searched as a whole."""
    v, u = np.mgrid[:480, :640]
    return [
        np.where(np.hypot(u - x, v - 240) < 60, 200, 20).astype(np.uint8).tobytes()
        for x in (150, 450)
    ]


class Camera:
    """Publishes images and notes the answers."""

    def __init__(self) -> None:
        self._contents, self._numbers = images(), count()
        self._published: dict[int, int] = {}
        self.answers: list[tuple[int, float, int, int]] = []
        self._out = rospy.Publisher(IMAGE_TOPIC, Image, queue_size=1)
        rospy.Subscriber(STATUS_TOPIC, DiagnosticArray, self._note, queue_size=1000)
        while not (self._out.get_num_connections() and rospy.get_published_topics("/eyespot")):
            time.sleep(0.1)
        time.sleep(1.0)

    def _note(self, message: Any) -> None:
        now, stamp = rospy.get_time(), message.header.stamp
        values = {pair.key: pair.value for pair in message.status[0].values}
        counts = int(values["images"]), int(values["skipped_images"])
        self.answers.append((self._published[stamp.to_nsec()], now - stamp.to_sec(), *counts))

    def publish(self, rate_hz: float, seconds: float) -> int:
        """Publish at a rate; the number of images."""
        began, sent = time.monotonic(), 0
        while (at := sent / rate_hz) < seconds:
            time.sleep(max(began + at - time.monotonic(), 0))
            number, stamp = next(self._numbers), rospy.Time.now()
            self._published[stamp.to_nsec()] = number
            data = self._contents[number % 2]
            self._out.publish(Image(Header(stamp=stamp), 480, 640, "mono8", 0, 640, data))
            sent += 1
        time.sleep(1.0)
        return sent


def main(answers: Path, seconds: float) -> None:
    """Find the reader's rate, publish at twice of it, and write what came back."""
    rospy.init_node("camera")
    camera = Camera()
    camera.publish(rate_hz=300.0, seconds=3.0)
    reads_hz, before = len(camera.answers) / 3.0, len(camera.answers)
    published = camera.publish(rate_hz=2 * reads_hz, seconds=seconds)
    written = {"reads_hz": reads_hz, "published": published, "answers": camera.answers[before:]}
    answers.write_text(json.dumps(written))


if __name__ == "__main__":
    main(Path(sys.argv[1]), float(sys.argv[2]))
