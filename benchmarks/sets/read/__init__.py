"""A set on disk.

image_rows    Every image of a set with what is known of it; the lines of a split's metadata.jsonl
labelled_set  A labelled set on disk
stacks        The stacks that export and score go through, and what a set calls them and their
              images
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
