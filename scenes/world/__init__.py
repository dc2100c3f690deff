"""What a scene means: wall, microscope, beam, motion, light, labels.

geometry     The scene's geometry as `optics` objects, and what a motion may not do in it
labels       Labels of every frame of a scene, from the exact geometry
light_cache  The light of a glue lens in its medium: half a minute's quadrature, kept on disk
             between runs
motion       Where the tip is at any moment: the kinds of motion, and the clocks that sample them
photometry   How bright the scene is: indirect light, and the exposure behind the `paper` frames
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
