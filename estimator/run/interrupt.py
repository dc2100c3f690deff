"""Ctrl-C ends a command within two seconds, whatever the command is doing.

Python alone does not: it raises KeyboardInterrupt in whatever Python code runs next. Native code
that compiles or renders may run for many seconds before that. And an exception is dropped if it is
raised in a callback of the garbage collector (JAX registers one), a finalizer, or a C library.
"""

from __future__ import annotations

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

_AGAIN_S = 0.02  # until a dropped KeyboardInterrupt is raised again

_pressed = threading.Event()


def ctrl_c_was_pressed() -> bool:
    """Whether Ctrl-C was pressed. Native code turns a KeyboardInterrupt into errors of its own."""
    return _pressed.is_set()


def end_now() -> NoReturn:
    """End the process as stopped, without Python's clean-up: it crashes in a running renderer."""
    with suppress(OSError, ValueError):
        sys.stdout.flush()
        sys.stderr.flush()
    os._exit(STOPPED)


@contextmanager
def ending_on_ctrl_c() -> Iterator[None]:
    """Let Ctrl-C end this process: by a KeyboardInterrupt, and after `PATIENCE_S` at once.

    To be used in the main thread.
    """
    reading, writing = os.pipe()
    os.set_blocking(writing, False)
    # Written to by the C signal handler itself, also while the main thread runs native code.
    before = signal.set_wakeup_fd(writing, warn_on_full_buffer=False)
    handlers = {
        number: signal.signal(number, _interrupt) for number in (signal.SIGINT, signal.SIGALRM)
    }
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
    raise KeyboardInterrupt


def _raise_again(unraisable: Any) -> None:
    if issubclass(unraisable.exc_type, KeyboardInterrupt):
        # By a timer: raised here, it would be dropped as well.
        signal.setitimer(signal.ITIMER_REAL, _AGAIN_S)
    else:
        sys.__unraisablehook__(unraisable)


def _end_at_last(signals: int) -> None:
    received = os.read(signals, 1)
    while received and received[0] != signal.SIGINT:
        received = os.read(signals, 1)
    if received:
        _pressed.set()
        time.sleep(PATIENCE_S)
        end_now()
    os.close(signals)
