"""Light of the wall behind pixels: the image model of the fits and of the pixels mode.

cells       Wall points behind pixels and their radiance, and light on a lattice of square cells
cone        Light of a uniform cone: on pixels, exact at the edge or spread by the wall; on cells
lens        Light of a glue lens, as line integrals around pixels, from a table
pose_light  Light on a lattice by a beam whose pose is sought, compiled for the rig
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
