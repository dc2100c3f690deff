"""The node's messages: spot, range, pose, and what is said when a topic is silent.

ROS 1 and ROS 2 name these types alike. The types are those of the ROS that runs:
`sensor_msgs/Range` has a variance since Jazzy, and a subscriber with another version of the type
would receive nothing.
"""

import math
import time
from collections.abc import Callable, Collection
from typing import Any

import numpy as np

from eyespot.estimator.distance.range import TipPose
from eyespot.estimator.rig.rig_reader import RigOutput
from eyespot.formats.poses import Pose

PERIOD_S = 1.0  # how often a node should look
_LIMIT_S = 2.0  # a rig's camera takes 20 images in this time


def image_type(topic: str) -> str:
    """Name of the messages of an image topic; image_transport's ends in /compressed."""
    return "CompressedImage" if topic.endswith("/compressed") else "Image"


class Silence:
    """The time since the last image of a topic.

    Args:
        clock: s; does not jump.
    """

    def __init__(self, topic: str, clock: Callable[[], float] = time.monotonic) -> None:
        self._topic, self._clock = topic, clock
        self._last_s = clock()
        self.said = ""
        """What is wrong at this moment; empty if images arrive."""

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
            changed, self.said = said != self.said, said
            return (said, True) if changed else None
        changed, self.said = self.said != "", ""
        return (f"images arrive on {self._topic}.", False) if changed else None

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


def message_types() -> dict[str, Any]:
    """The types of the node's topics, by the topic's name in `Parameters`."""
    from diagnostic_msgs import msg as diagnostic
    from geometry_msgs import msg as geometry
    from sensor_msgs import msg as sensor

    return {
        "spot": geometry.PointStamped,
        "axes": geometry.Vector3Stamped,
        "range": sensor.Range,
        "beam": geometry.PoseWithCovarianceStamped,
        "status": diagnostic.DiagnosticArray,
    }


def messages_of(output: RigOutput, image: Any) -> dict[str, Any]:
    """The messages of an output by topic, without those that have nothing to say.

    Args:
        image: `sensor_msgs/Image` that was measured; the messages get its time and its frame.
    """
    from geometry_msgs import msg as geometry
    from sensor_msgs import msg as sensor

    x, y, valid = output.centre
    major, minor, angle = output.axes
    distance = sensor.Range(
        header=_header(image),
        radiation_type=sensor.Range.INFRARED,
        field_of_view=0.0,  # along the beam's axis
        min_range=0.0,
        max_range=math.inf,
        range=output.distance_m,
    )
    if hasattr(distance, "variance") and not math.isnan(output.sigma_m):
        distance.variance = output.sigma_m**2
    messages = {
        "spot": geometry.PointStamped(
            header=_header(image), point=geometry.Point(x=x, y=y, z=valid)
        ),
        "axes": geometry.Vector3Stamped(
            header=_header(image), vector=geometry.Vector3(x=major, y=minor, z=angle)
        ),
        "range": distance,
        "status": status_message(output.level, output.doubt or "ok", image, output.details),
    }
    if output.beam is not None:
        messages["beam"] = _beam(output.beam, _header(image))
    return messages


def _beam(beam: TipPose, header: Any) -> Any:
    """Tip and axis in the eye's frame, m; the axis is the pose's +z."""
    from geometry_msgs import msg as geometry

    x, y, z = (np.asarray(beam.axis) / np.linalg.norm(beam.axis)).tolist()
    rotation = Pose.along((x, y, z), time_s=0.0, position_mm=(0.0, 0.0, 0.0)).rotation
    assert beam.covariance is not None
    assert beam.across is not None
    # A turn of the axis towards a vector across it is a rotation about axis x vector.
    slopes = np.zeros((6, 5))
    slopes[:3, :3] = 1e-3 * np.eye(3)
    slopes[3:, 3:] = np.cross(beam.axis, beam.across).T
    covariance = slopes @ beam.covariance @ slopes.T
    # Nothing is known of the rotation about the beam.
    covariance[3:, 3:] += math.pi**2 * np.outer(beam.axis, beam.axis)
    header.frame_id = "eye"
    x, y, z = (1e-3 * np.asarray(beam.tip_mm)).tolist()
    pose = geometry.Pose(
        position=geometry.Point(x=x, y=y, z=z),
        orientation=geometry.Quaternion(**dict(zip("xyzw", rotation, strict=True))),
    )
    spread = geometry.PoseWithCovariance(pose=pose, covariance=covariance.ravel().tolist())
    return geometry.PoseWithCovarianceStamped(header=header, pose=spread)


def status_message(level: str, said: str, image: Any, details: dict[str, str] | None = None) -> Any:
    """A status at the time of an image: OK, WARN, ERROR, or STALE if images have stopped."""
    from diagnostic_msgs import msg as diagnostic

    status = diagnostic.DiagnosticStatus(
        level=getattr(diagnostic.DiagnosticStatus, level),
        name="eyespot",
        message=said,
        values=[
            diagnostic.KeyValue(key=key, value=value) for key, value in (details or {}).items()
        ],
    )
    return diagnostic.DiagnosticArray(header=_header(image), status=[status])


def _header(image: Any) -> Any:
    """A new header: ROS 1 numbers the headers that it sends."""
    from std_msgs.msg import Header

    return Header(stamp=image.header.stamp, frame_id=image.header.frame_id)
