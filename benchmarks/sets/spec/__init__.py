"""What a set is to be.

distributions  Distributions over a scene key: from a number in [0, 1) to a value
planning       From a spec to the scene of every stack, evenly spread over what varies
spec           The spec of a labelled set: TOML, validated before anything is rendered
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
