"""The rig's node: microscope images in, the spot, its axes and its distance out.

    python -m estimator.rig.node _microscope:=/data/microscope.json            # ROS 1
    python -m estimator.rig.node --ros-args -p microscope:=/data/microscope.json   # ROS 2

`rig` measures; `ros1` and `ros2` connect it to topics. docs/rig.md lists topics and parameters.
"""

from __future__ import annotations

import sys

from estimator.rig import ros1, ros2
from estimator.rig.generation import is_ros2
from optics import InputError


def main() -> None:
    """Run the node under the ROS that was found until that ROS shuts down."""
    try:
        (ros2 if is_ros2() else ros1).run()
    except (InputError, OSError) as error:
        print(f"eyespot: {error}", file=sys.stderr)
        sys.exit(2)


if __name__ == "__main__":
    main()
