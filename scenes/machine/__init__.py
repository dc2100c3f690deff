"""Mitsuba and the libraries that it needs on this machine.

doctor   What this machine can do for eyespot, and what to do about each thing that is missing
llvm     Finds a libLLVM that Dr.Jit can compile kernels with; needs nothing but the standard
         library
variant  The one door to Mitsuba, so that Dr.Jit never meets a libLLVM that aborts the process
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
