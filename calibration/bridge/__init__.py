"""Mitsuba as a JAX function.

render_bridge  A renderer as a JAX function of its parameters, with derivatives
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
