"""Tip and axis from one spot and from three.

analytic  The analytic part: exact contours with noise, over the working volume
command   The command `eyespot study pose`
errors    Rows of pose_error.csv, how priors are drawn, and what many rows amount to
figures   Pictures of the study of poses: errors beside their bounds and the best reported figures
rendered  The rendered part: frames of an even wall, spots by the estimator, poses by its exact
          model
report    The report of the study of poses: sentences and tables, all from this run's numbers
run       `eyespot study pose`: tip and axis of the tool from one spot and from three
tool      A tool with one cone of light or three, and its pose from the spots of all of them at
          once
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
