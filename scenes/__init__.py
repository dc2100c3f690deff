"""Physically based image stacks with labels: Mitsuba 3 renders what `optics` describes."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
