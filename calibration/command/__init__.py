"""The command `eyespot fit`.

arguments     Command-line text converted to values: priors, rotation, log books
command       The options of `eyespot fit`
cone_model    Model cone: the exact geometry fitted to the spots' ellipses
eye_model     Model eye: how an unknown eye shows the spots of a known cone
fitted        The choices and the result that all models share
fitting       A whole fit, from recordings to a report, a table and a calibration file
goodness      Checks of a fit: convergence, bounds, chi squared, runs of residuals
lens_guess    A start lens, chosen by the sizes and edge widths of the spots
models        The models by name, and the automatic choice of one
paper_models  Models plane and sphere: the fits of Zhou et al. 2020
pixel_models  Models image and lens, fitted to every pixel of one stack
recording     Records a fit for the viewer rerun: frames, spots, distances, residuals
remedies      The criteria that a fit must meet, and what to try if it does not meet one
report        The report: one HTML page with its pictures inside
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
