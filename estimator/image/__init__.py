"""What a frame is, and what is measured in it.

camera  A camera's matrix and lens distortion, as OpenCV defines them
frames  Frames as light: what is accepted, through which response, over which wall
spot    What a measurement returns: a spot, or the reason why there is none
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
