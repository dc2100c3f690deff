"""Model error against the position of the spot.

causes    The error of every model, split by cause so that the parts sum to the whole
chain     The chain from a distance to a spot's size and back, with each link real or ideal
command   The command `eyespot study eccentricity`
figures   The results of a run, and the figures of the report
limits    The c at which a model's error reaches a limit, for the true and for a fitted c
rendered  The rendered part: frames, measured spots, and the effect of rendering on their size
run       The study: exact contours, rendered frames, the space of geometries, page
space     Every model's error at scrambled Sobol points of the space of geometries
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
