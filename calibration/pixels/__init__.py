"""Fits to every pixel of a stack.

chunks         The image model on chunks of pixels, compiled once
cone           Light of a uniform cone: the exact lit part of pixels, light that a wall spreads
data           Frames as light with a known noise, with the conditions of the recording
fit            The entry points: fit source, brightness and pose to all pixels at once
image_fit      The result of a fit to all pixels
lens           Conversion between a glue lens and fit parameters
lens_light     The table of a lens's light in a running fit: when it is computed anew, how finely
misfit         What the model leaves in the residuals, and how much it may bias the fit
model          Radiance of the wall lit by a cone or a lens, as a differentiable function
parameters     Names, units and valid ranges of the parameters
selection      Which pixels a fit uses: those the beam reaches and a ring around them
setup          What a fit starts from: its constants, start values and priors
solver         The steps of the fit, from blurred frames to all pixels
squares        Squares of pixels that are fitted as one datum where a lens's light is smooth
table          The light of a lens on a grid, to first order in its parameters
table_samples  Samples of this table by quadrature, denser at edges
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
