"""Physically based image stacks with labels: Mitsuba 3 renders what `optics` describes.

camera/       Camera model: from linear frames to digital numbers
description/  The scene file: its keys, their validation, and how it is read and written
drawn/        Frames computed by formula, without rendering; their ellipses are known exactly
machine/      Checks for Mitsuba and the system libraries that it needs
rendering/    Rendering with Mitsuba: from a scene to linear frames
stacks/       Labelled image stacks on disk
walls/        Pictures on the wall
world/        Everything derived from a scene: wall, microscope, beam, motion, light, labels
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
