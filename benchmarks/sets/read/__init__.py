"""Reads a set.

beams         The light source of a rendered stack
image_rows    The images of a set with their labels: the lines of metadata.jsonl
labelled_set  A set and its stacks, from set.json
own_readers   Readers of our estimator for the frames of a stack, by mode
stacks        The stacks of a set, or a single stack; names of stacks and images within a set
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
