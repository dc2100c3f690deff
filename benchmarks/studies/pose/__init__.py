"""Tip and axis from one spot and from three.

analytic  The analytic part: exact contours with noise, over the working volume
command   The command `eyespot study pose`
errors    A pose in the working volume, and the error of an estimate of it
figures   The figures of the report
findings  The results as data: the error of every pose, and summaries
rendered  The rendered part: frames of an even wall, spots and poses by the estimator
report    The report
run       The computation: exact contours, rendered frames, errors
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
