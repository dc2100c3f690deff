"""Bugs that are met in single frames: logged and counted, so that a long run reaches its end.

A frame that raises what is not an `InputError` has the reason `Reason.INTERNAL_ERROR`. The command
line calls `taken` at its end, and fails if there are such frames.
"""

import logging
import traceback
from collections import Counter

_log = logging.getLogger("eyespot")
_MAX_TRACEBACKS = 5  # that are logged, each from another place of the code
_bugs: Counter[tuple[str, int | None]] = Counter()  # by their place in the code


def taken() -> int:
    """Number of frames that met a bug since this was last called."""
    number = _bugs.total()
    _bugs.clear()
    return number


def note(error: Exception, where: str) -> None:
    """Count an unexpected exception, and log its traceback if its place in the code is new."""
    place = traceback.extract_tb(error.__traceback__)[-1]
    at = place.filename, place.lineno
    if at not in _bugs and len(_bugs) < _MAX_TRACEBACKS:
        _log.error(
            "%s met a bug in eyespot. Its reason is internal_error, as of all frames that meet it.",
            where,
            exc_info=error,
        )
    _bugs[at] += 1
