"""Pictures on the wall.

fundus_image  A drawn fundus: reflectance of disc, macula, vessels and choroid from a random seed
landmarks     Coordinates of the map; positions and sizes of fovea and optic disc
picture       The picture that a scene selects, also from an image file, and its mean colour
random_wall   A wall without a picture: grain, vessels and shading drawn at random
spread        How far walls scatter light sideways: lengths for each colour, with their sources
vessels       The vessel tree of the drawn fundus
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
