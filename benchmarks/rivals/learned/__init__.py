"""A small network from frame to ellipse and distance, with sigmas of its own.

crops      Windows of a frame: where they lie, their pixels, and the ellipse in numbers
estimator  The trained network as an estimator, and its weights
making     Makes the weights and judges them: `eyespot rivals train`
network    The network and its loss
training   The windows of a set, and the training on them, resumable after every epoch

training.toml is the spec of the set that the weights were trained on; weights.eqx and weights.json
are the weights and how they were made.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
