"""A program: plays a bag to the rig's node under ROS 2, and writes what the node answers.

    python tests/support/rig/ros2_player.py BAG ANSWERS.json SPEED

The bytes of the bag are published as they are. The topics, and the bag's clock, come to life before
the first image; the program ends two seconds after the last one.
"""

import json
import sys
import threading
import time
from pathlib import Path
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PointStamped, Transform, Vector3Stamped
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rosbags.highlevel import AnyReader
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Image, Range

IN = {"/decklink/camera/image_raw": Image, "/eye_robot/FrameEE": Transform}
OUT = {"spot": PointStamped, "axes": Vector3Stamped, "range": Range, "status": DiagnosticArray}
_TICK_NS = 25_000_000  # of the bag's clock; `ros2 bag play` takes the same 40 Hz
PATIENCE_S = 200.0  # the node may compile a model before it subscribes


def content(name: str, message: Any) -> list[Any]:
    """What is compared, of a message of one of the node's topics."""
    if name == "range":
        return [message.range, getattr(message, "variance", 0.0)]
    if name == "status":
        (status,) = message.status
        return [status.message, {pair.key: pair.value for pair in status.values}]
    vector = message.point if name == "spot" else message.vector
    return [vector.x, vector.y, vector.z]


class Player(Node):
    """Publishes messages of a bag and notes the answers."""

    def __init__(self) -> None:
        super().__init__("player")
        self.answers: list[tuple[str, int, float, list[Any]]] = []
        self._clock_out = self.create_publisher(Clock, "/clock", 10)
        self._out = {topic: self.create_publisher(kind, topic, 10) for topic, kind in IN.items()}
        self._in = [
            self.create_subscription(kind, f"/eyespot/{name}", self._note(name), 1000)
            for name, kind in OUT.items()
        ]

    def _note(self, name: str) -> Any:
        def note(message: Any) -> None:
            stamp = message.header.stamp
            time_ns = stamp.sec * 10**9 + stamp.nanosec
            self.answers.append((name, time_ns, time.monotonic(), content(name, message)))

        return note

    def wait_for_node(self) -> None:
        """Return when each topic has its other end."""
        deadline = time.monotonic() + PATIENCE_S
        outs = [self._clock_out, *self._out.values()]
        while not (
            all(out.get_subscription_count() for out in outs)
            and all(self.count_publishers(f"/eyespot/{name}") for name in OUT)
        ):
            if time.monotonic() > deadline:
                sys.exit("the node did not come to life")
            time.sleep(0.1)
        time.sleep(1.0)  # the node may know of this end a little later

    def play(self, bag: Path, speed: float) -> dict[int, float]:
        """Publish a bag's messages in time; when each image was published, by its time."""
        sent: dict[int, float] = {}
        with AnyReader([bag]) as reader:
            began, first, ticked = time.monotonic(), reader.start_time, 0
            for connection, time_ns, data in reader.messages():
                time.sleep(max(began + (time_ns - first) / 1e9 / speed - time.monotonic(), 0))
                if time_ns - ticked >= _TICK_NS:
                    ticked, clock = time_ns, Clock()
                    clock.clock.sec, clock.clock.nanosec = divmod(time_ns, 10**9)
                    self._clock_out.publish(clock)
                if IN[connection.topic] is Image:
                    sent[time_ns] = time.monotonic()
                self._out[connection.topic].publish(bytes(data))
        return sent


def main(bag: Path, answers: Path, speed: float) -> None:
    rclpy.init()
    player = Player()
    executor = SingleThreadedExecutor()
    executor.add_node(player)
    thread = threading.Thread(target=executor.spin)
    thread.start()
    player.wait_for_node()
    sent = player.play(bag, speed)
    time.sleep(2.0)
    answers.write_text(json.dumps({"sent": sent, "answers": player.answers}))
    executor.shutdown()
    thread.join()
    rclpy.shutdown()


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]), float(sys.argv[3]))
