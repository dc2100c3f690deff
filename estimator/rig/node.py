"""The rig's node: microscope images in, the spot, its axes and its distance out.

    python -m estimator.rig.node _microscope:=/data/microscope.json            # ROS 1
    python -m estimator.rig.node --ros-args -p microscope:=/data/microscope.json   # ROS 2

`rig` measures; `ros1` and `ros2` connect it to topics. docs/rig.md lists topics and parameters.
"""

from __future__ import annotations

import importlib.util
import os
import sys

from estimator.rig import ros1, ros2
from formats.inputs import InputError


def is_ros2() -> bool:
    """Whether ROS 2 is there, by the setup file that was sourced, or else by its library."""
    sourced = os.environ.get("ROS_VERSION")
    return sourced == "2" if sourced else importlib.util.find_spec("rclpy") is not None


def main() -> None:
    """Run the node under the ROS that was found until that ROS shuts down."""
    try:
        (ros2 if is_ros2() else ros1).run()
    except (InputError, OSError) as error:
        print(f"eyespot: {error}", file=sys.stderr)
        sys.exit(2)


if __name__ == "__main__":
    main()
