"""Fits to every pixel of a stack, whatever the wall shows.

data        Frames as light with a known noise, with the conditions of the recording
fit         The entry points, and the rounds of a fit from wide cells to small ones
image_fit   The result of a fit to all pixels
lens_light  The table of a lens's light in a running fit: when it is computed anew, how finely
light       The light of all frames on square cells, with all derivatives
misfit      What the model leaves in the residuals, and how much it may bias the fit
parameters  Names, units and valid ranges of the parameters
solver      The fit with the wall eliminated: weights, learnt variances, an even wall as a test
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
