"""A small network from frame to ellipse and distance, with sigmas of its own.

network   Windows of a frame, the network and its loss, the trained network as an estimator
training  The windows of a set, the training on them, and its weights: `eyespot rivals train`

training.toml is the spec of the set that the weights were trained on; weights.eqx and weights.json
are the weights and how they were made.
"""
