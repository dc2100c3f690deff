"""What the node and a topic of images need of ROS 2."""

import threading
from array import array
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any, Self

from eyespot.estimator.rig.messages import PERIOD_S
from eyespot.estimator.rig.rig_reader import POSES_KEPT, Parameters
from eyespot.formats.inputs import InputError
from eyespot.formats.ros_bags import stamp_s

_OF_ROS = ("use_sim_time", "start_type_description_service", "qos_overrides.")
"""Parameters that each node has, or how their names begin."""
_SETTINGS = "settings."


class Ros2:
    """A node of ROS 2, whose callbacks run in one thread: that of `spin`, or one of its own."""

    stamp_s = staticmethod(lambda image: stamp_s(image.header))

    def __init__(self, name: str, **options: Any) -> None:
        import rclpy

        self._node = rclpy.create_node(name, **options)
        self._arrived, self._ended = threading.Event(), False

    @classmethod
    @contextmanager
    def running(cls, name: str) -> Iterator[Self]:
        """The node of a process of its own."""
        import rclpy

        rclpy.init()
        try:
            yield cls(name, automatically_declare_parameters_from_overrides=True)
        finally:
            rclpy.try_shutdown()

    @classmethod
    def beside(cls, name: str) -> Self:
        """A node of a process that ends by its own handlers of signals."""
        import rclpy

        rclpy.init(args=[], signal_handler_options=rclpy.signals.SignalHandlerOptions.NO)
        ros = cls(name)
        threading.Thread(target=rclpy.spin, args=(ros._node,), daemon=True).start()
        return ros

    def parameters(self) -> Parameters:
        """The node's parameters, all declared: read-only, with their descriptions.

        Raises:
            InputError: as `Parameters.of`.
        """
        from rcl_interfaces.msg import ParameterDescriptor

        given: dict[str, Any] = {}
        settings: dict[str, Any] = {}
        for name, parameter in self._node.get_parameters_by_prefix("").items():
            if not name.startswith(_OF_ROS):
                value = parameter.value
                to = settings if name.startswith(_SETTINGS) else given
                of = list(value) if isinstance(value, array) else value
                to[name.removeprefix(_SETTINGS)] = of
        parameters = Parameters.of(given | ({"settings": settings} if settings else {}))
        for name, field in Parameters.model_fields.items():
            description = ParameterDescriptor(
                description=field.description or f"Topic {name.removesuffix('_topic')}.",
                read_only=True,
                dynamic_typing=True,
            )
            if self._node.has_parameter(name):
                self._node.set_descriptor(name, description)
            elif name != "settings":
                self._node.declare_parameter(name, field.default, description)
        return parameters

    def resolved(self, topic: str) -> str:
        """The whole name of a topic.

        Raises:
            InputError: it is no topic's name.
        """
        from rclpy.exceptions import InvalidTopicNameException
        from rclpy.validate_topic_name import validate_topic_name

        try:
            validate_topic_name(topic)
        except InvalidTopicNameException as error:
            rule = f"{error}".partition(":")[2].partition(":")[0].strip()
            raise InputError(
                f"topic {topic!r}: {rule}. Write /a/topic, or ~/topic for the node's own."
            ) from error
        return str(self._node.resolve_topic_name(topic))

    def publisher(self, topic: str, kind: Any) -> Any:
        """Publishes messages."""
        return self._node.create_publisher(kind, self.resolved(topic), 10)

    def take_images(self, topic: str, kind: Any, take: Callable[[Any, int], None]) -> None:
        """Give each image with the number of its publisher.

        At most one waits for `take`, unless the topic's quality of service says more.
        """
        from rclpy.qos import QoSHistoryPolicy

        waiting: deque[tuple[Any, int]] = deque()

        def on_image(image: Any, about: Any) -> None:
            waiting.append((image, about["publication_sequence_number"]))
            self._arrived.set()

        def work() -> None:
            while self._arrived.wait() and not self._ended:
                self._arrived.clear()
                while waiting and not self._ended:
                    take(*waiting.popleft())

        quality = self._subscribe(topic, kind, on_image, 1)
        if quality.history is not QoSHistoryPolicy.KEEP_ALL:
            waiting = deque(waiting, maxlen=quality.depth)
        # In a thread of its own: poses get the time of their arrival, so they must not wait.
        self._images = threading.Thread(target=work, daemon=True)
        self._images.start()

    def take_poses(self, topic: str, kind: Any, take: Callable[[Any, float], None]) -> None:
        """Give each pose with the time of its arrival, s."""
        clock = self._node.get_clock()
        self._subscribe(
            topic, kind, lambda pose: take(pose, clock.now().nanoseconds / 1e9), POSES_KEPT
        )

    def _subscribe(self, topic: str, kind: Any, callback: Callable[..., None], depth: int) -> Any:
        from rclpy.qos import QoSProfile, QoSReliabilityPolicy
        from rclpy.qos_overriding_options import QoSOverridingOptions

        # As for sensor data: what is lost is not sent again.
        quality = QoSProfile(depth=depth, reliability=QoSReliabilityPolicy.BEST_EFFORT)
        overridable = QoSOverridingOptions.with_default_policies()
        name = self.resolved(topic)
        self._node.create_subscription(
            kind, name, callback, quality, qos_overriding_options=overridable
        )
        return quality

    def types_of(self, topic: str) -> list[str]:
        """The message types under which a topic is published."""
        return [about.topic_type for about in self._node.get_publishers_info_by_topic(topic)]

    def say(self, text: str, *, is_fault: bool) -> None:
        """Log a message."""
        # A logger of ROS 2 refuses to change its level on the same line.
        if is_fault:
            self._node.get_logger().error(text)
        else:
            self._node.get_logger().info(text)

    def spin(self, watch: Callable[[], None]) -> None:
        """Call `watch` every `PERIOD_S` until ROS shuts down."""
        import rclpy
        from rclpy.clock import Clock, ClockType
        from rclpy.executors import ExternalShutdownException

        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._node.create_timer(PERIOD_S, watch, clock=steady)
        try:
            with suppress(KeyboardInterrupt, ExternalShutdownException):
                rclpy.spin(self._node)
        finally:
            self._ended = True
            self._arrived.set()
            self._images.join()
