"""Model error against the place of the spot.

causes    The error of every model split by cause, so that the parts sum to the whole
chain     The chain from a distance to a spot's size and back, each link of which can be real
          or ideal
command   The command `eyespot study eccentricity`
figures   Figures of the study of eccentricity
findings  What the study of eccentricity finds: errors of the models, where they exceed limits, and
          why
limits    The c at which a model's error reaches a limit, with the true c and with a fitted one
rendered  The rendered part: frames, the spots measured in them, and what rendering adds to their
          size
report    The report of the study of eccentricity
run       `eyespot study eccentricity`: how wrong each model is, where, and by which cause
shapley   Shapley's fair shares: what each player adds to a whole, over all orders of joining
space     The space of geometries: scrambled Sobol points, every model's error there, in
          bounded memory
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
