"""Physics of the spot as pure, differentiable functions: mm, rad, px; JAX in float64."""

import os
import sys

import lazy_loader

# Half a micrometre at 200 mm needs more than float32's seven digits. JAX reads the variable at its
# first import; if JAX is already imported, its setting must be changed.
os.environ["JAX_ENABLE_X64"] = "1"
if "jax" in sys.modules:
    sys.modules["jax"].config.update("jax_enable_x64", True)

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
