"""The eye's own optics and the surgeon's lenses between the microscope and the retina."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
