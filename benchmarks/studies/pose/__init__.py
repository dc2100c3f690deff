"""Tip and axis from one spot and from three.

analytic  The analytic part: exact contours with noise, over the working volume
command   The command `eyespot study pose`
errors    The working volume, a pose in it, and the error of an estimate
rendered  The rendered part: frames of an even wall, spots and poses by the estimator
run       The study: exact contours, rendered frames, summaries, figures, page
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
