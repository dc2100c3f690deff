"""Reads a set.

labelled_set  A set and its stacks, from set.json
stacks        The stacks of a set, or a single stack: names, images, true beams, our readers
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
