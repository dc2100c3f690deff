"""From linear frames to the numbers that a camera writes.

camera    Camera: one sensor of a scene, which photographs linear frames
exposure  The camera: noise-free light in, digital numbers out, after EMVA 1288 (release 4.0,
          linear)
output    What a camera makes of its raw frame: colours from a Bayer mosaic, and JPEG
response  Response curves of cameras: from light to digital numbers and back, without noise
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
