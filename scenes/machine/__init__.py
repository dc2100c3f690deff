"""Checks for Mitsuba and the system libraries that it needs.

doctor   The command `eyespot doctor`: checks this machine and explains how to fix problems
llvm     Finds a libLLVM that Dr.Jit can use
variant  Loads Mitsuba with a safe libLLVM
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
