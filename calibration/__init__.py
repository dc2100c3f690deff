"""Fits of model parameters to spots or pixels, each with a standard deviation.

bridge/      Mitsuba as a JAX function
command/     `eyespot fit`
pixels/      Fits to every pixel of a stack
recorded_trial  Stacks, spots files and bags read as trials with the robot's readings
solvers      Least squares with covariance
spots/       Fits to the ellipses of spots
tolerances   What a rig states to a tolerance, as priors of every fit
"""

import lazy_loader

from eyespot import optics  # noqa: F401 - switches JAX to 64 bits before the first array

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
