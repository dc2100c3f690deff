"""ROS 1 node for the rig: microscope images in, the spot, its axes and its distance out.

    python -m estimator.rig.node _microscope:=/data/microscope.json _calibration:=/data/cone.json

`rig` measures; this module connects it to topics. docs/rig.md lists topics and parameters.
"""

from __future__ import annotations

import importlib
import math
import sys
from typing import Any

from estimator.rig.rig import POSES_KEPT, Doubt, Parameters, Rig
from optics import InputError

_DEBIAN_PACKAGES = "/usr/lib/python3/dist-packages"  # rospy, outside of environments
# Larger than an uncompressed 1920x1080 RGB image (6.2 MB). In a smaller buffer old images wait, so
# that the next image is not the newest.
_BUFFER_BYTES = 2**25


def main() -> None:
    """Run the node until ROS shuts down."""
    try:
        rospy = _imported_rospy()
        rospy.init_node("eyespot")
        parameters = Parameters.of(rospy.get_param("~", {}))
        connect(Rig(parameters), parameters)
    except (InputError, OSError) as error:
        print(f"eyespot: {error}", file=sys.stderr)
        sys.exit(2)
    rospy.spin()


def connect(rig: Rig, parameters: Parameters) -> None:
    """Subscribe the rig to topics of images and poses, and publish its measurements."""
    import rospy
    from diagnostic_msgs import msg as diagnostic
    from geometry_msgs import msg as geometry
    from sensor_msgs import msg as sensor
    from std_msgs.msg import Header

    spots = rospy.Publisher(parameters.spot_topic, geometry.PointStamped, queue_size=10)
    axes = rospy.Publisher(parameters.axes_topic, geometry.Vector3Stamped, queue_size=10)
    ranges = rospy.Publisher(parameters.range_topic, sensor.Range, queue_size=10)
    statuses = rospy.Publisher(parameters.status_topic, diagnostic.DiagnosticArray, queue_size=10)

    levels = diagnostic.DiagnosticStatus
    level_of = {Doubt.NONE: levels.OK, Doubt.DOUBTFUL: levels.WARN, Doubt.FAILED: levels.ERROR}

    def on_image(image: Any) -> None:
        reading = rig.output(image, image.header.stamp.to_sec())
        if reading.level is Doubt.FAILED:
            rospy.logerr_throttle(1.0, reading.doubt)
        header = Header(stamp=image.header.stamp, frame_id=image.header.frame_id)
        spots.publish(header, geometry.Point(*reading.centre))
        axes.publish(header, geometry.Vector3(*reading.axes))
        ranges.publish(
            header=header,
            radiation_type=sensor.Range.INFRARED,
            field_of_view=0.0,  # along the beam's axis
            min_range=0.0,
            max_range=math.inf,
            range=reading.distance_m,
        )
        status = diagnostic.DiagnosticStatus(
            level=level_of[reading.level],
            name="eyespot",
            message=reading.doubt or "ok",
            values=[diagnostic.KeyValue(*item) for item in reading.details.items()],
        )
        statuses.publish(header, [status])

    def on_pose(pose: Any) -> None:
        try:
            rig.take_pose(pose, rospy.get_time())
        except InputError as error:
            rospy.logerr_throttle(1.0, f"{error}")

    rospy.Subscriber(parameters.pose_topic, geometry.Transform, on_pose, queue_size=POSES_KEPT)
    # At most one image waits: a node that cannot keep up skips images and measures the newest.
    rospy.Subscriber(
        parameters.image_topic, sensor.Image, on_image, queue_size=1, buff_size=_BUFFER_BYTES
    )


def _imported_rospy() -> Any:
    """ROS's library for Python, which is not installed in the environment.

    Raises:
        InputError: ROS is not installed.
    """
    # At the end of the path, so that it hides no package of the environment. The folders of a ROS
    # whose setup file was sourced come first.
    sys.path.append(_DEBIAN_PACKAGES)
    try:
        return importlib.import_module("rospy")
    except ModuleNotFoundError as error:
        raise InputError(
            f"ROS 1 is not installed: {error}. Run tools/install-ros, or source the setup file of"
            " your ROS."
        ) from error


if __name__ == "__main__":
    main()
