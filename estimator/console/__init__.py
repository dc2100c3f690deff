"""A page in the browser for the operator of a rig: `eyespot console`.

advice     What the operator can do about the exposure
command    The command `eyespot console`
gate       Who may see the page: this machine, or whoever has the token
guide      A calibration guided by the console: withdraw from contact, see coverage, fit, save
page       The page: image, distance, course of the last 30 s, controls
panel      The panel of a guided calibration on the page
picture    What is drawn over the image, as SVG
recorders  What the operator records: a spots file, or a bag with the frames
session    Reads a source frame by frame in a thread of its own, and takes the operator's commands
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
