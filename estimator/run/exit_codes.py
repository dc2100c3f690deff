"""How a command ends: its message on an error, and its exit code.

Exit codes:
    0    done
    1    `eyespot doctor` found something missing, `eyespot rig check` a line that is wrong;
         any other command: a bug, with its traceback
    2    bad input, or a part of this machine that is missing; one message on stderr says which
    130  stopped with Ctrl-C
"""

import errno
import os
import sys
from collections.abc import Callable

from cyclopts import CycloptsError, MissingArgumentError
from cyclopts.exceptions import UnknownOptionError

from eyespot.estimator.run import frame_bugs
from eyespot.estimator.run.ctrl_c import STOPPED, ctrl_c_was_pressed, end_now, ending_on_ctrl_c
from eyespot.estimator.run.option_names import moved, option

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


def run_command(app: Callable[[], object]) -> None:
    """Run the command line and end the process. Only here it is decided what an error looks like.

    Our functions raise InputError for what the user can correct, the operating system OSError;
    their messages are printed. Any other exception is a bug and keeps its traceback. A long run
    goes on after a bug in one frame, and fails at its end.

    Args:
        app: raises SystemExit with the exit code of the command.
    """
    frame_bugs.taken()  # those of another caller in this process
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
        message = message_of(error) or _no_device()
        if message is None or os.environ.get("EYESPOT_TRACEBACK"):
            raise
        print(f"eyespot: {message}", file=sys.stderr)
        sys.exit(1 if bugs else 2)


def _no_device() -> str | None:
    """Why JAX computes nothing, if that is so; its own error may be one without a text."""
    jax, platforms = sys.modules.get("jax"), os.environ.get("JAX_PLATFORMS")
    if jax is None or not platforms:
        return None
    try:
        jax.devices()
    except (RuntimeError, AssertionError):
        return (
            f"JAX finds no device for JAX_PLATFORMS={platforms}. Unset this variable, or set it to "
            "cpu."
        )
    return None


def _reported_bugs() -> bool:
    number = frame_bugs.taken()
    if number:
        print(
            f"eyespot: {number} frames met a bug in eyespot; their reason is internal_error."
            " Report it to the developers, with the traceback above.",
            file=sys.stderr,
        )
    return number > 0


def _missing(error: CycloptsError) -> str | None:
    """What a command needs that the user has not given at all; None for other errors."""
    if not isinstance(error, MissingArgumentError) or error.keyword or error.argument is None:
        return None
    if error.argument.tokens:
        return None
    command = " ".join(["eyespot", *(error.command_chain or ())])
    about = (error.argument.parameter.help or "").partition("\n")[0].rstrip(".")
    name = error.argument.name
    return f"`{command}` needs {name}{f' ({about})' if about else ''}. See {command} --help."


def _also_unknown(error: CycloptsError, first: str = "") -> list[str]:
    """What to say of the options that do not exist, but for the first, whatever else is wrong."""
    if isinstance(error, MissingArgumentError) and error.keyword:
        return []  # the words behind an option without its value were not read
    words, known = error.unused_tokens or (), {first}
    if isinstance(error, UnknownOptionError) and error.unused_tokens is None:
        words = error.root_input_tokens or ()
        known |= {name for entry in error.argument_collection for name in entry.names}
    left = (word.partition("=")[0] for word in words if word.startswith("--"))
    return [
        moved(word[2:].replace("-", "_")) or f"Unknown option: {word}."
        for word in dict.fromkeys(left)
        if word not in known
    ]


def message_of(error: BaseException, *, of_options: bool = False) -> str | None:
    """The message of an expected error; None for a bug."""
    # A class whose module was never loaded cannot have been raised.
    modules = ("pydantic", "eyespot.scenes.machine.variant", "eyespot.formats.inputs")
    pydantic, variant, inputs = map(sys.modules.get, modules)
    if isinstance(error, UnknownOptionError):
        name = (error.token.keyword or error.token.value).partition("=")[0]
        said = moved(name.lstrip("-").replace("-", "_")) or str(error)
        return "\n".join([said, *_also_unknown(error, name)])
    if isinstance(error, CycloptsError):
        # `__context__` is what a settings model says of a value.
        of_model = message_of(error.__context__, of_options=True) if error.__context__ else None
        return "\n".join([of_model or _missing(error) or str(error), *_also_unknown(error)])
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
    if isinstance(error, ModuleNotFoundError) and (error.name or "").partition(".")[0] != "eyespot":
        return (
            f"this needs the Python package {error.name}, which is not installed. Run `make "
            "setup`; `make setup-rig` leaves out what only renders, or makes sets."
        )
    if isinstance(error, OSError) and error.filename:
        remedy = _REMEDIES.get(error.errno or 0, "")
        name = repr(str(error.filename))[1:-1][:300]  # a name may have line breaks
        return f"{name}: {error.strerror}. {remedy}".rstrip()
    ours = inputs and isinstance(error, inputs.InputError)
    return str(error) if ours or isinstance(error, OSError) else None
