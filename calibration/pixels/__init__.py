"""Fits to every pixel of a stack.

chunks      The image model on chunks of pixels, compiled once
data        Frames as light with a known noise, with the conditions of the recording
fit         The entry points: fit source, brightness and pose to all pixels at once
image_fit   The result of a fit to all pixels
lens_light  The table of a lens's light in a running fit: when it is computed anew, how finely
misfit      What the model leaves in the residuals, and how much it may bias the fit
parameters  Names, units and valid ranges of the parameters
selection   Which pixels a fit uses: those the beam reaches and a ring around them
solver      The fit: its start, the model on all chunks, and steps from blurred frames to sharp ones
squares     Squares of pixels that are fitted as one datum where a lens's light is smooth
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
