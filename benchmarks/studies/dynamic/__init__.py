"""The error while the tip moves.

command   The command `eyespot study dynamic`
figures   The figures of the report
findings  The results as data: the error of every frame, and its size by speed
measure   The rows of dynamic_error.csv: calibrate at rest, read frames, split the errors
parts     The parts of the error while the tip moves: rest, blur, stamps, latency
report    The report
run       The computation: render, read, split
trials    The scenes: tips moving at several speeds, with and without motion blur
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
