"""Light of the wall behind pixels: the image model of the fits and of the pixels mode.

cone             Light of a uniform cone: the exact lit part of pixels, light that a wall spreads
lens             Light of a glue lens, as line integrals around pixels
lens_parameters  Conversion between a glue lens and the parameters of its light
lens_samples     Samples of a lens's table by quadrature, denser at edges
lens_table       The light of a lens on a grid, to first order in its parameters
radiance         Wall points behind pixels, and their radiance
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
