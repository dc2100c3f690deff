"""Stacks, spots files and bags read as trials with the robot's readings.

trials       Recordings read as trials: spots from the estimator, readings and axis from the robot
withdrawals  Distance of the tip at each frame and mean axis, from the robot's poses
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
