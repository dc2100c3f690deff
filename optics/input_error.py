"""The error that says a value from outside is wrong; every other exception is a defect of ours."""

from __future__ import annotations

_LONGEST = 200  # characters of a value in a message
_MOST_LINES = 3  # of a message


class InputError(ValueError):
    """A value that the caller can correct; the text names it, its unit, the rule and the remedy.

    The command line prints the text of an InputError and ends with 2. A ValueError of Python, NumPy
    or SciPy comes from a defect of ours and keeps its traceback: a frame's "math domain error" is
    no fault of the one who took the frame.
    """


def shortened(value: object) -> str:
    """A value from outside as a message shows it: as Python writes it, at most 200 characters."""
    try:
        text = repr(value)
    except ValueError:  # Python writes no whole number of more than 4,300 digits
        text = f"{type(value).__name__} with very large numbers"
    return text if len(text) <= _LONGEST else f"{text[:_LONGEST]}…"


def at_most_three(problems: list[str]) -> str:
    """A message of at most three lines from any number of problems, one in a line."""
    more = len(problems) - _MOST_LINES
    if more <= 0:
        return "\n".join(problems)
    return "\n".join([*problems[: _MOST_LINES - 1], f"and {more + 1} more problems like these."])
