"""The eye's own optics and the surgeon's lenses between the microscope and the retina.

camera  The microscope behind a path: pixels of wall points, pencils, coaxial light, reflexes
eye     Eyes at one wavelength and the surgeon's lenses, from files
path    Viewing paths: what lies between the microscope and the retina, and its lines of sight
trace   Rays traced from the microscope through conic surfaces and media into the eye
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
