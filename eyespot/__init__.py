"""How far can you trust a distance measured from a spot of light in a microscope image?

    import eyespot
    eyespot.render(eyespot.Scene(), "stack", {"source.kind": "cone"})
    fit = eyespot.fit("stack")
    fit.save("beam.json")
    spots = eyespot.track("stack", calibration="beam.json")

Each function is also a command (`eyespot render`, …). From Python nothing is printed;
`progress=True` shows a bar.

command_line  The command `eyespot`: finds the command that was called
functions     render, track, fit, score, dataset
results       What they return
signatures    Every command without what it imports, for help and the check of options
studies       The studies, each a function
"""

import os
from typing import Any

import lazy_loader

from eyespot.formats.cache_folder import cache_folder

# Compilation is half of a short run; the next run takes it from this cache, also the hundreds of
# programs that take a moment each: for a fit these are five seconds together.
os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", f"{cache_folder()}/eyespot/jax")
os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0")
# OpenCV, FFmpeg and XLA would print their own account of an error that we report once; XLA also of
# a compilation that takes long on a busy machine.
os.environ.setdefault("OPENCV_LOG_LEVEL", "SILENT")
os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")
os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")

_attached, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from importlib import metadata  # takes as long as all else here

        return metadata.version("eyespot")
    return _attached(name)
