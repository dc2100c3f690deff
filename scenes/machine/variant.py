"""Loads Mitsuba with a libLLVM that does not abort the process. All code loads Mitsuba here.

As a script, it checks whether a variant, the main one by default, renders (exit code 0 or 1). One
that fails may abort its process.
"""

import os
import sys
from types import ModuleType

import numpy as np

from eyespot.formats.inputs import InputError
from eyespot.scenes.machine.llvm import (
    DEBIAN_COMMAND,
    ENVIRONMENT_VARIABLE,
    OLDEST_USABLE,
    REMEDY,
    find_llvm,
)

_loaded_in: set[int] = set()
"""The process that has loaded Mitsuba; a fork of it inherits this, and no thread."""


class RendererUnavailable(RuntimeError):
    """This variant of Mitsuba cannot run in this process; the message says what to do."""


def load_mitsuba(variant: str = "llvm_ad_rgb") -> ModuleType:
    """Load Mitsuba and set its variant, which must be the same for all calls in a process.

    Args:
        variant: name of the variant, such as `llvm_ad_rgb` or `scalar_rgb`.

    Returns:
        The module `mitsuba`.

    Raises:
        InputError: this build of Mitsuba has no such variant.
        RendererUnavailable: a system library or the GPU is missing, or this process already uses
            another variant.
    """
    if _loaded_in and os.getpid() not in _loaded_in:
        raise RendererUnavailable(
            "this process was forked from one that has rendered, whose threads it lacks; it would "
            "wait for ever. Use multiprocessing.get_context('spawn')."
        )
    needs_llvm = variant.startswith("llvm")
    if "drjit" in sys.modules:
        _check_loaded_llvm(needed=needs_llvm)
    else:
        _choose_llvm(needed=needs_llvm)
    try:
        import mitsuba
    except ModuleNotFoundError:
        raise
    except (ImportError, NameError) as error:
        # Dr.Jit 1.5 raises a NameError by mistake while it reports the ImportError.
        raise RendererUnavailable(
            f"Mitsuba cannot be loaded ({error.__context__ or error}). Install the missing library "
            f"(Debian, as root: `{DEBIAN_COMMAND}`)."
        ) from error

    if variant not in mitsuba.variants():
        known = ", ".join(mitsuba.variants())
        raise InputError(f"load_mitsuba({variant!r}): no such variant; choose one of {known}.")
    if mitsuba.variant() not in (None, variant):
        raise RendererUnavailable(
            f"load_mitsuba({variant!r}): this process already renders with {mitsuba.variant()}, "
            "and objects of one variant cannot be used by another. Start a new process."
        )
    try:
        mitsuba.set_variant(variant)
    except ImportError as error:
        if not variant.startswith("cuda"):
            raise
        raise RendererUnavailable(
            f"load_mitsuba({variant!r}): no NVIDIA GPU with a working driver was found. "
            "Use llvm_ad_rgb, which needs none."
        ) from error
    _loaded_in.add(os.getpid())
    return mitsuba


def _choose_llvm(*, needed: bool) -> None:
    """Set the variable that selects the libLLVM; Dr.Jit reads it once, on import."""
    llvm = find_llvm()
    if needed and not llvm:
        raise RendererUnavailable(
            f"Mitsuba cannot render: {llvm} Without it, `eyespot render --variant scalar_rgb` "
            "renders scenes of source.kind 'cone', slowly."
        )
    # Otherwise Dr.Jit would load an old libLLVM even for a variant that needs none.
    os.environ[ENVIRONMENT_VARIABLE] = str(llvm.path) if llvm else os.devnull


def _check_loaded_llvm(*, needed: bool) -> None:
    """Check the libLLVM that Dr.Jit has already loaded, if it was imported earlier."""
    import drjit

    major = drjit.detail.llvm_version()[0]
    if needed and major < OLDEST_USABLE:
        found = f"LLVM {major}" if major > 0 else "no LLVM"
        raise RendererUnavailable(
            f"Mitsuba cannot render: drjit was already imported and loaded {found}. "
            f"Call load_mitsuba() before `import drjit`. {REMEDY}"
        )


if __name__ == "__main__":
    try:
        mi = load_mitsuba(*sys.argv[1:])
    except RendererUnavailable as unavailable:
        sys.exit(str(unavailable))
    film = {"type": "hdrfilm", "width": 8, "height": 8}
    grey_ball_in_white_light = {
        "type": "scene",
        "integrator": {"type": "path"},
        "light": {"type": "constant"},
        "ball": {"type": "sphere", "center": [0, 0, 4]},
        "camera": {"type": "perspective", "film": film},
    }
    brightness = np.asarray(mi.render(mi.load_dict(grey_ball_in_white_light), spp=4)).mean()
    if not 0 < brightness < 2:
        sys.exit(f"a grey ball in white light has brightness {brightness}")
    print(f"Mitsuba {mi.__version__} can render.")
    print("Ready. Next: source .venv/bin/activate, then eyespot --help")
