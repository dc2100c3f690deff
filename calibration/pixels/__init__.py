"""Fits to every pixel of a stack.

chunks      The image model on chunks of pixels, compiled once for every frame and every stage of
            a fit
data        Frames as light with a known noise, and what a log book says of how they were taken
fit         Every pixel of a withdrawal fitted at once: source, brightness and pose, with their
            sigmas
image_fit   The result of a fit to all pixels
lens        A glue lens as the parameters of a fit, and back
model       What a pixel sees: the light of a cone or a lens on the wall, as a differentiable
            function
parameters  The parameters of the fit to all pixels: names, units, and what they may be
selection   Which pixels a fit takes: what the beam reaches and a ring about it, less what hides
            the wall
solver      How the fit to all pixels goes: from the start, coarse and blurred, to all pixels as
            they are
table       The light of a lens near some parameters: vector irradiance and its slopes on a small
            grid
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
