"""Tip and axis from one spot and from three.

analytic  The analytic part: exact contours with noise, over the working volume
command   The command `eyespot study pose`
errors    A pose of the working volume, and how far an estimate is from it
figures   Figures of the study of poses: errors beside their bounds and the best reported ones
findings  What the study of poses finds: the error of every pose, and summaries of many
rendered  The rendered part: frames of an even wall, spots by the estimator, poses by its exact
          model
report    The report of the study of poses
run       `eyespot study pose`: tip and axis of the tool from one spot and from three
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
