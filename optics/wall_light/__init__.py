"""Light of the wall on cells of the image: the image model of the fits and of the mode pixels.

cells         Light on a lattice of square cells
cone          Light of a uniform cone, exact at the edge
lens          Light of a glue lens, as line integrals around cells, from a table
pose_light    Light on a lattice by a beam whose pose is sought, compiled for the rig
unknown_wall  What one frame says of a distance, if nobody knows the wall
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
