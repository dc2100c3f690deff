"""The command `eyespot fit`.

choices       The choices of a fit: the options of `eyespot fit`, defined once
command       The command
cone_models   Models cone and eye: the exact geometry fitted to the spots' ellipses
fitted        The result that all models share
fitting       A whole fit, from recordings to a report, a table, a calibration file
page          The templates of all HTML pages
paper_models  Models plane and sphere: the fits of Zhou et al. 2020
pixel_models  Models image and lens, fitted to every pixel of one stack
report        The report: one HTML page with its pictures inside
verdict       The verdict on a fit, and what to try if it is not good
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
