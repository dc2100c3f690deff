"""Which ROS is there: 1 or 2."""

from __future__ import annotations

import importlib.util
import os


def is_ros2() -> bool:
    """Whether ROS 2 is there, by the setup file that was sourced, or else by its library."""
    sourced = os.environ.get("ROS_VERSION")
    return sourced == "2" if sourced else importlib.util.find_spec("rclpy") is not None
