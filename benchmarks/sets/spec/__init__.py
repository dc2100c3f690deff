"""The spec of a set, and the scenes that follow from it.

distributions  Distributions of a scene key
planning       From a spec to the scenes of all stacks, spread evenly over the distributions
spec           The spec file (TOML) and its validation
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
