"""Light of the wall behind pixels: the image model of the fits and of the pixels mode.

cells          Light on a lattice of square cells, by integrals along their shared sides
cone           Light of a uniform cone: the exact lit part of pixels, light that a wall spreads
lens           Light of a glue lens, as line integrals around pixels
parameters     Conversion between a glue lens and the parameters of its light
pixel_light    Wall points behind pixels, and their radiance
pose_light     Light on a lattice by a beam whose pose is sought, compiled for the rig
solid_angle    Light of a uniform cone on cells: shares of its solid angle, in closed form
table          The light of a lens on a grid, to first order in its parameters
table_samples  Samples of this table by quadrature, denser at edges
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
