"""Camera model: from linear frames to digital numbers.

camera       Camera: exposes linear frames with the sensor of a scene, and meters the exposure time
exposure     Sensor model (EMVA 1288, release 4.0, linear): light in, digital numbers out
information  Fisher information of the sensor about the light of a pixel
output       Bayer mosaic, demosaicing and JPEG
response     Response curves: from light to digital numbers and back, without noise
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
