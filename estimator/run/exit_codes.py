"""How a command ends: its message on an error, and its exit code.

Exit codes:
    0    done
    1    `eyespot doctor` found something missing; any other command: a bug, with its traceback
    2    bad input, or a part of this machine that is missing; one message on stderr says which
    130  stopped with Ctrl-C
"""

from __future__ import annotations

import errno
import os
import sys
from collections.abc import Callable

from cyclopts import CycloptsError

from estimator.run import internal_errors
from estimator.run.interrupt import STOPPED, ctrl_c_was_pressed, end_now, ending_on_ctrl_c
from optics import InputError

_REMEDIES = {
    errno.EACCES: "Choose a place that you may write to.",
    errno.EDQUOT: "Free some of your quota, or choose another disk.",
    errno.EEXIST: "Choose another name; existing files are never overwritten.",
    errno.EFBIG: "Raise the limit on a file's size, or write fewer frames.",
    errno.ENOENT: "Check the path.",
    errno.ENOSPC: "Free some space, or choose another disk.",
    errno.ENOTDIR: "A part of this path is a file; choose a folder.",
    errno.EROFS: "Choose a place that can be written to.",
}
"""What to do about an error of the operating system."""

_OURS = ("optics", "scenes", "estimator", "calibration", "benchmarks")


def run_command(app: Callable[[], object]) -> None:
    """Run the command line and end the process. Only here it is decided what an error looks like.

    Our functions raise InputError for what the user can correct, the operating system OSError;
    their messages are printed. Any other exception is a bug and keeps its traceback. A long run
    goes on after a bug in one frame, and fails at its end.

    Args:
        app: raises SystemExit with the exit code of the command.
    """
    internal_errors.taken()  # those of another caller in this process
    try:
        with ending_on_ctrl_c():
            app()
    except SystemExit as end:
        if end.code and ctrl_c_was_pressed():
            end_now()
        sys.exit(1 if _reported_bugs() else end.code)
    except KeyboardInterrupt:
        if ctrl_c_was_pressed():
            end_now()
        sys.exit(STOPPED)
    except Exception as error:
        if ctrl_c_was_pressed():
            end_now()
        bugs = _reported_bugs()
        message = message_of(error)
        if message is None or os.environ.get("EYESPOT_TRACEBACK"):
            raise
        print(f"eyespot: {message}", file=sys.stderr)
        sys.exit(1 if bugs else 2)


def option(name: str) -> str:
    """How a field is written on the command line."""
    return f"--{name.replace('_', '-')}"


def _reported_bugs() -> bool:
    number = internal_errors.taken()
    if number:
        print(
            f"eyespot: {number} frames met a bug in eyespot; their reason is internal_error."
            " Report it to the developers, with the traceback above.",
            file=sys.stderr,
        )
    return number > 0


def message_of(error: BaseException, *, of_options: bool = False) -> str | None:
    """The message of an expected error; None for a bug."""
    # A class whose module was never loaded cannot have been raised.
    pydantic, variant = map(sys.modules.get, ("pydantic", "scenes.machine.variant"))
    if isinstance(error, CycloptsError):
        # `__context__` is what a settings model says of a value.
        of_model = message_of(error.__context__, of_options=True) if error.__context__ else None
        return of_model or str(error)
    if pydantic and isinstance(error, pydantic.ValidationError):
        return "\n".join(
            f"{option(name) if of_options else name}: {rule}; got {problem['input']!r}"
            for problem in error.errors()
            if (name := ".".join(map(str, problem["loc"])))
            if (rule := problem["msg"].removeprefix("Value error, "))
        )
    if variant and isinstance(error, variant.RendererUnavailable):
        return str(error)
    if isinstance(error, ImportError) and isinstance(error.__cause__, ImportError):
        return message_of(error.__cause__)  # of a command's module, loaded by its name
    if isinstance(error, ModuleNotFoundError) and error.name not in _OURS:
        return f"the Python package {error.name} is not installed. Run `make setup` again."
    if isinstance(error, OSError) and error.filename:
        remedy = _REMEDIES.get(error.errno or 0, "")
        name = repr(str(error.filename))[1:-1][:300]  # a name may have line breaks
        return f"{name}: {error.strerror}. {remedy}".rstrip()
    return str(error) if isinstance(error, InputError | OSError) else None
