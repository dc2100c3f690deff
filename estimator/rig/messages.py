"""An output as the messages of the node's topics.

ROS 1 and ROS 2 name these types alike. The types are those of the ROS that runs:
`sensor_msgs/Range` has a variance since Jazzy, and a subscriber with another version of the type
would receive nothing.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from estimator.distance import TipPose
from estimator.files import Pose
from estimator.rig.rig import Doubt, Output, Parameters


class Messages(NamedTuple):
    """One for each topic of the node, or what belongs to each: its type, its publisher."""

    spot: Any
    axes: Any
    range: Any
    beam: Any
    status: Any


def topics_of(parameters: Parameters) -> Messages:
    """The names of the topics."""
    return Messages(
        parameters.spot_topic,
        parameters.axes_topic,
        parameters.range_topic,
        parameters.beam_topic,
        parameters.status_topic,
    )


def message_types() -> Messages:
    """The types of the topics."""
    from diagnostic_msgs import msg as diagnostic
    from geometry_msgs import msg as geometry
    from sensor_msgs import msg as sensor

    return Messages(
        geometry.PointStamped,
        geometry.Vector3Stamped,
        sensor.Range,
        geometry.PoseWithCovarianceStamped,
        diagnostic.DiagnosticArray,
    )


def messages_of(output: Output, image: Any) -> Messages:
    """The messages of an output; None for a topic on which it has nothing to say.

    Args:
        output: of the rig.
        image: `sensor_msgs/Image` that was measured; the messages get its time and its frame.
    """
    from geometry_msgs import msg as geometry
    from sensor_msgs import msg as sensor

    types = message_types()
    level = {Doubt.NONE: "OK", Doubt.DOUBTFUL: "WARN", Doubt.FAILED: "ERROR"}[output.level]
    x, y, valid = output.centre
    major, minor, angle = output.axes
    distance = types.range(
        header=_header(image),
        radiation_type=sensor.Range.INFRARED,
        field_of_view=0.0,  # along the beam's axis
        min_range=0.0,
        max_range=math.inf,
        range=output.distance_m,
    )
    if hasattr(distance, "variance") and not math.isnan(output.sigma_m):
        distance.variance = output.sigma_m**2
    return Messages(
        spot=types.spot(header=_header(image), point=geometry.Point(x=x, y=y, z=valid)),
        axes=types.axes(header=_header(image), vector=geometry.Vector3(x=major, y=minor, z=angle)),
        range=distance,
        beam=None if output.beam is None else _beam(output.beam, types.beam, _header(image)),
        status=_status(level, output.doubt or "ok", output.details, _header(image)),
    )


def _beam(beam: TipPose, kind: Any, header: Any) -> Any:
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
    message = kind(header=header)
    message.header.frame_id = "eye"
    place, turn = message.pose.pose.position, message.pose.pose.orientation
    place.x, place.y, place.z = (1e-3 * np.asarray(beam.tip_mm)).tolist()
    turn.x, turn.y, turn.z, turn.w = rotation
    message.pose = geometry.PoseWithCovariance(
        pose=message.pose.pose, covariance=covariance.ravel().tolist()
    )
    return message


def silence_message(said: str, image: Any) -> Any:
    """A status for images that have stopped.

    Args:
        said: what is wrong.
        image: the last one that arrived.
    """
    return _status("STALE", said, {}, _header(image))


def _status(level: str, said: str, details: dict[str, str], header: Any) -> Any:
    from diagnostic_msgs import msg as diagnostic

    status = diagnostic.DiagnosticStatus(
        level=getattr(diagnostic.DiagnosticStatus, level),
        name="eyespot",
        message=said,
        values=[diagnostic.KeyValue(key=key, value=value) for key, value in details.items()],
    )
    return diagnostic.DiagnosticArray(header=header, status=[status])


def _header(image: Any) -> Any:
    """A new header: ROS 1 numbers the headers that it sends."""
    from std_msgs.msg import Header

    return Header(stamp=image.header.stamp, frame_id=image.header.frame_id)
