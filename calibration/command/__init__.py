"""`eyespot fit`.

arguments     Arguments of `eyespot fit`, from text to values: priors, rotation, log books of
              recordings
command       The command `eyespot fit`
cone_model    The model cone of `eyespot fit`: the exact geometry, fitted to the spots' ellipses
fitted        The choices that every model of `eyespot fit` takes, and the result of its fit
fitting       A fit from start to end: recordings in; a report, a table and a calibration file out
goodness      Whether a fit may be called good: convergence, bounds, chi squared, runs of
              residuals
lens_guess    A lens to start the fit to pixels from, chosen by the sizes and edges of the spots
models        The models that `eyespot fit` knows, by name, and the choice of one from the spots
paper_models  The paper's models of `eyespot fit`: a line through planes, and c of an eyeball
pixel_models  The models of `eyespot fit` that every pixel of one stack is fitted with: image and
              lens
report        The report of `eyespot fit`: one HTML page with its pictures inside
result_table  The fitted parameters as a table on the terminal
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
