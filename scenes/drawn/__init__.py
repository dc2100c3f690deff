"""Frames drawn by formula instead of rendered: their spots are known exactly.

drawing      Frames with spots that are known exactly: the estimator's ground truth
ingredients  What a drawn frame may be made of: any ellipse, any retina, a shaft, a shadow, glints
profiles     Light of a drawn spot across its edge: sharp, domed, bell-shaped, or that of a glue
             lens
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
