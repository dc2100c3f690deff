"""The error while the tip moves.

command  The command `eyespot study dynamic`
measure  Calibrated at rest, frames read; the parts of the error: rest, blur, stamps, latency
run      The study: motions, errors, their sizes by speed, figures, page
trials   The scenes: tips moving at several speeds, with and without motion blur
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
