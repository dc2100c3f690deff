"""Physically based image stacks with labels: Mitsuba 3 renders what `optics` describes.

camera/       From linear frames to the numbers that a camera writes
description/  The scene file: what a person may write, validated
drawn/        Frames drawn by formula instead of rendered: their spots are known exactly
machine/      Mitsuba and the libraries that it needs on this machine
rendering/    From a scene to linear frames, with Mitsuba
stacks/       Stacks on disk
walls/        Pictures of the wall
world/        What a scene means: wall, microscope, beam, motion, light, labels
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
