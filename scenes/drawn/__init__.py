"""Frames computed by formula, without rendering; their ellipses are known exactly.

drawing      A frame from an ellipse, its light, a wall, occlusion, motion blur and noise
ingredients  Random ellipses and walls; shafts, shadows and glints
profiles     Profiles of the light across the edge: sharp, domed, bell-shaped, or of a glue lens
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
