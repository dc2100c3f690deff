"""Stacks, spots files and bags as trials with readings.

trials       Recordings as trials: spots measured by the estimator, readings and axis from the
             robot's report
withdrawals  How far the tip had gone at each frame, and along which axis: from the robot's
             reports
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
