"""A small network from frame to ellipse and distance, with sigmas of its own.

crops      Windows of a frame: where they lie, and their pixels
estimator  The trained network as an estimator, and its weights
judging    Factors for the sigmas and the least presence, from the split validation
making     Makes the weights: `eyespot rivals train`
network    The network and its loss
samples    What the network is shown in training
targets    The numbers that the network gives, and the ellipse that they mean
training   The training, resumable after every epoch

training.toml is the spec of the set that the weights were trained on; weights.eqx and weights.json
are the weights and how they were made.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
