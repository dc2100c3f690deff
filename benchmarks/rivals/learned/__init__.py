"""A small network from frame to ellipse and distance, with sigmas of its own.

training.toml is the spec of the set that the weights were trained on; weights.eqx and weights.json
are the weights and how they were made.
"""
