"""Bugs that are met in single frames: logged and counted, so that a long run reaches its end.

A frame that raises what is not an `InputError` has the reason `Reason.INTERNAL_ERROR`. The command
line calls `taken` at its end, and fails if there are such frames.
"""

from __future__ import annotations

import logging
import traceback

_log = logging.getLogger("eyespot")
_WHOLE = 5  # tracebacks that are logged, each from another place of the code
_places: set[tuple[str, int | None]] = set()
_met = 0


def taken() -> int:
    """Number of frames that met a bug since this was last called."""
    global _met
    number, _met = _met, 0
    _places.clear()
    return number


def note(error: Exception, where: str) -> None:
    """Count an unexpected exception, and log its traceback if its place in the code is new.

    Args:
        error: what was raised.
        where: the frame.
    """
    global _met
    _met += 1
    place = traceback.extract_tb(error.__traceback__)[-1]
    known = (place.filename, place.lineno) in _places
    if known or len(_places) == _WHOLE:
        return
    _places.add((place.filename, place.lineno))
    _log.error(
        "%s met a bug in eyespot. Its reason is internal_error, as of all frames that meet it.",
        where,
        exc_info=error,
    )
