"""The node under ROS 2."""

from __future__ import annotations

import threading
from array import array
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any

from estimator.rig.messages import (
    PERIOD_S,
    Silence,
    image_type,
    message_types,
    messages_of,
    silence_message,
    topics_of,
)
from estimator.rig.rig import POSES_KEPT, OutputState, Parameters, Rig, opened_rig
from formats.inputs import InputError
from formats.ros_bags import stamp_s

_OF_ROS = ("use_sim_time", "start_type_description_service", "qos_overrides.")
"""Parameters that each node has, or how their names begin."""
_SETTINGS = "settings."


def run() -> None:
    """Run the node until ROS shuts down.

    Raises:
        InputError: parameters or files are wrong.
        OSError: a file cannot be read.
    """
    import rclpy
    from rclpy.executors import ExternalShutdownException

    rclpy.init()
    try:
        node = rclpy.create_node("eyespot", automatically_declare_parameters_from_overrides=True)
        parameters = parameters_of(node)
        with opened_rig(parameters) as rig:
            connection = Ros2Connection(node, rig, parameters)
            with suppress(KeyboardInterrupt, ExternalShutdownException), connection.measuring():
                rclpy.spin(node)
    finally:
        rclpy.try_shutdown()


def parameters_of(node: Any) -> Parameters:
    """The parameters of a node, all declared: read-only, with their descriptions.

    Args:
        node: which has declared the parameters that were given to it.

    Raises:
        InputError: as `Parameters.of`.
    """
    from rcl_interfaces.msg import ParameterDescriptor

    given: dict[str, Any] = {}
    settings: dict[str, Any] = {}
    for name, parameter in node.get_parameters_by_prefix("").items():
        if not name.startswith(_OF_ROS):
            value = parameter.value
            to = settings if name.startswith(_SETTINGS) else given
            to[name.removeprefix(_SETTINGS)] = list(value) if isinstance(value, array) else value
    parameters = Parameters.of(given | ({"settings": settings} if settings else {}))
    for name, field in Parameters.model_fields.items():
        description = ParameterDescriptor(
            description=field.description or f"Topic {name.removesuffix('_topic')}.",
            read_only=True,
            dynamic_typing=True,
        )
        if node.has_parameter(name):
            node.set_descriptor(name, description)
        elif name != "settings":
            node.declare_parameter(name, field.default, description)
    return parameters


def check_topics(*names: str) -> None:
    """Raise an InputError unless these are names of topics."""
    from rclpy.exceptions import InvalidTopicNameException
    from rclpy.validate_topic_name import validate_topic_name

    for name in names:
        try:
            validate_topic_name(name)
        except InvalidTopicNameException as error:
            rule = f"{error}".partition(":")[2].partition(":")[0].strip()
            raise InputError(
                f"topic {name!r}: {rule}. Write /a/topic, or ~/topic for the node's own."
            ) from error


class Ros2Connection:
    """Subscribes the rig to images and poses, and publishes its outputs."""

    def __init__(self, node: Any, rig: Rig, parameters: Parameters) -> None:
        from geometry_msgs.msg import Transform
        from rclpy.clock import Clock, ClockType
        from rclpy.qos import QoSHistoryPolicy, QoSProfile, QoSReliabilityPolicy
        from rclpy.qos_overriding_options import QoSOverridingOptions
        from sensor_msgs import msg as sensor

        self._node, self._rig, self._last = node, rig, None
        self._log = node.get_logger()
        poses, names = parameters.pose_topic, topics_of(parameters)
        check_topics(parameters.image_topic, poses, *names)
        self._topic = node.resolve_topic_name(parameters.image_topic)
        self._out = [
            node.create_publisher(kind, name, 10)
            for name, kind in zip(names, message_types(), strict=True)
        ]
        self._silence = Silence(self._topic)
        # As for sensor data: what is lost is not sent again. At most one image waits: a node that
        # cannot keep up skips images and measures the newest.
        newest = QoSProfile(depth=1, reliability=QoSReliabilityPolicy.BEST_EFFORT)
        every = QoSProfile(depth=POSES_KEPT, reliability=QoSReliabilityPolicy.BEST_EFFORT)
        for kind, topic, callback, qos in (
            (getattr(sensor, image_type(self._topic)), self._topic, self._on_image, newest),
            (Transform, poses, self._on_pose, every),
        ):
            overridable = QoSOverridingOptions.with_default_policies()
            node.create_subscription(kind, topic, callback, qos, qos_overriding_options=overridable)
        depth = None if newest.history is QoSHistoryPolicy.KEEP_ALL else newest.depth
        self._waiting: deque[tuple[Any, int]] = deque(maxlen=depth)
        self._arrived, self._ended = threading.Event(), False
        node.create_timer(PERIOD_S, self._watch, clock=Clock(clock_type=ClockType.STEADY_TIME))

    @contextmanager
    def measuring(self) -> Iterator[None]:
        """Measure the images that arrive in the `with` block."""
        # In a thread of its own: poses get the time of their arrival, so they must not wait.
        thread = threading.Thread(target=self._measure)
        thread.start()
        try:
            yield
        finally:
            self._ended = True
            self._arrived.set()
            thread.join()

    def _measure(self) -> None:
        while self._arrived.wait() and not self._ended:
            self._arrived.clear()
            while self._waiting and not self._ended:
                self._publish(*self._waiting.popleft())

    def _publish(self, image: Any, number: int) -> None:
        output = self._rig.output(image, stamp_s(image.header), number)
        if output.level is OutputState.FAILED:
            self._log.error(output.doubt, throttle_duration_sec=1.0)
        for publisher, message in zip(self._out, messages_of(output, image), strict=True):
            if message is not None:
                publisher.publish(message)

    def _watch(self) -> None:
        def types() -> list[str]:
            found = self._node.get_publishers_info_by_topic(self._topic)
            return [publisher.topic_type for publisher in found]

        if change := self._silence.change(types):
            said, is_fault = change
            # A logger of ROS 2 refuses to change its level on the same line.
            if is_fault:
                self._log.error(said)
            else:
                self._log.info(said)
        if self._silence.said and self._last is not None:
            self._out[-1].publish(silence_message(self._silence.said, self._last))

    def _on_image(self, image: Any, about: Any) -> None:
        self._silence.end()
        self._last = image
        self._waiting.append((image, about["publication_sequence_number"]))
        self._arrived.set()

    def _on_pose(self, pose: Any) -> None:
        try:
            self._rig.poses.take(pose, self._node.get_clock().now().nanoseconds / 1e9)
        except InputError as error:
            self._log.error(f"{error}", throttle_duration_sec=1.0)
