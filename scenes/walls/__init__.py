"""Pictures of the wall.

fundus_image  A retina from a seed: the reflectance of disc, macula, vessels and choroid as a map
              for a wall
image_file    The wall's picture from a user's image file
picture       The picture on a phantom's wall, from a seed or a file, and its mean colour
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
