"""`eyespot fit`.

command       The command `eyespot fit`
fitted        What every model of `eyespot fit` takes, and what its fit comes to
fitting       A fit from start to end: recordings in; a report, a table and a calibration file out
goodness      Whether a fit may be called good: convergence, bounds, chi squared, runs of
              residuals
models        The models that `eyespot fit` knows: recordings in, one kind of result out
pixel_models  The models of `eyespot fit` that every pixel of one stack is fitted with: image and
              lens
report        The report of `eyespot fit`: one HTML page with its pictures inside
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
