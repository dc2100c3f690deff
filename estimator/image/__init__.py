"""Frames, and the spot that is measured in them.

camera   A camera's matrix and lens distortion, as OpenCV defines them
clipping  Where an image's values end: the level at which a sensor clips them
display  Frames and spots as they are shown to people
frame    Frames: what is accepted as an image, and rectangles of it
light    Converts frames into light: inverts the camera's response, and removes the wall's texture
noise    A camera's temporal noise after EMVA 1288
photon_transfer  A camera's noise from pairs of frames of an even wall
spot     The result of a measurement: a spot, or the reason why there is none
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
