"""Ctrl-C ends a command within two seconds, unless it is writing what it has.

Python alone does not: it raises KeyboardInterrupt in whatever Python code runs next. Native code
that compiles or renders may run for many seconds before that. And an exception is dropped if it is
raised in a callback of the garbage collector (JAX registers one), a finalizer, or a C library.

A command that has results to write takes the time for it, see `finish_first`.
"""

import os
import signal
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from types import FrameType
from typing import Any, NoReturn

STOPPED = 128 + signal.SIGINT
"""Exit code of a command that Ctrl-C ended, as shells report it: 130."""

PATIENCE_S = 2.0
"""Time that a command has to end by itself. All results are written whole or not at all, so a
process may end at any moment."""

_AGAIN_S = 0.02  # time after which a dropped KeyboardInterrupt is raised again

_pressed = threading.Event()
_finishing = threading.Event()


def ctrl_c_was_pressed() -> bool:
    """Whether Ctrl-C was pressed. Native code turns a KeyboardInterrupt into errors of its own."""
    return _pressed.is_set()


def end_now() -> NoReturn:
    """End the process as stopped, without Python's clean-up: it crashes in a running renderer."""
    with suppress(OSError, ValueError):
        sys.stdout.flush()
        sys.stderr.flush()
    os._exit(STOPPED)


def finish_first() -> None:
    """Give a command that Ctrl-C reached the time to write its results, on a busy machine too.

    From here on a second Ctrl-C ends the process at once.
    """
    _finishing.set()


@contextmanager
def ending_on_ctrl_c() -> Iterator[None]:
    """Let Ctrl-C end this process: by a KeyboardInterrupt, and after `PATIENCE_S` at once.

    A command that called `finish_first` ends at a second Ctrl-C only, or by itself.

    To be used in the main thread.
    """
    reading, writing = os.pipe()
    os.set_blocking(writing, False)
    # Written to by the C signal handler itself, also while the main thread runs native code.
    before = signal.set_wakeup_fd(writing, warn_on_full_buffer=False)
    handlers = {
        number: signal.signal(number, _interrupt) for number in (signal.SIGINT, signal.SIGALRM)
    }
    _pressed.clear()
    _finishing.clear()
    hook, sys.unraisablehook = sys.unraisablehook, _raise_again
    threading.Thread(target=_end_at_last, args=(reading,), daemon=True).start()
    try:
        yield
    finally:
        sys.unraisablehook = hook
        for number, handler in handlers.items():
            signal.signal(number, handler)
        signal.set_wakeup_fd(before)
        os.close(writing)  # ends the thread, unless it counts down already


def _interrupt(number: int, frame: FrameType | None) -> None:
    _pressed.set()
    if not _finishing.is_set():
        raise KeyboardInterrupt


def _raise_again(unraisable: Any) -> None:
    if issubclass(unraisable.exc_type, KeyboardInterrupt):
        # By a timer: raised here, it would be dropped as well.
        signal.setitimer(signal.ITIMER_REAL, _AGAIN_S)
    else:
        sys.__unraisablehook__(unraisable)


def _end_at_last(signals: int) -> None:
    if _ctrl_c_comes(signals):
        _pressed.set()
        time.sleep(PATIENCE_S)
        if not _finishing.is_set() or _ctrl_c_comes(signals):
            end_now()
    os.close(signals)


def _ctrl_c_comes(signals: int) -> bool:
    """Wait for the next Ctrl-C; False if the command ends first."""
    received = os.read(signals, 1)
    while received and received[0] != signal.SIGINT:
        received = os.read(signals, 1)
    return bool(received)
