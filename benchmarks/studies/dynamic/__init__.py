"""The error while the tip moves.

command   The command `eyespot study dynamic`
figures   Figures of the dynamic study
findings  What the dynamic study finds: the error of every frame, and its size by speed
measure   From stacks to rows of dynamic_error.csv: calibrate at rest, read frames, split the
          errors
parts     What a moving tip adds to the error of a distance, part by part
report    The report of the dynamic study
run       `eyespot study dynamic`: the error of a distance while the tip moves, and what makes it
trials    The scenes of the dynamic study: tips moving at several speeds, and the same without blur
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
