"""What a scene means: wall, microscope, beam, motion, light, labels.

geometry     What is at rest in a scene, as `optics` objects: wall, place of [spot], microscope
labels       The labels of a frame that follow from the scene's geometry
light_cache  The light of a glue lens in its medium: half a minute's quadrature, kept on disk
             between runs
limits       What a scene may not do: enter the wall, leave the window, fold the image
motion       Where the tip is at any moment: the kinds of motion, and the clocks that sample them
photometry   How bright the scene is: indirect light, and the exposure behind the `paper` frames
world        World: everything that a scene means, each part derived once and handed down from
             here
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
