"""Numbers as text, alone and in sentences."""

from __future__ import annotations

import math
import string
from collections.abc import Mapping
from typing import Any


def number(value: float, digits: int = 2, *, sign: bool = False) -> str:
    """The value with a true minus sign; zero has no sign; infinite values and NaN are a dash."""
    return _typeset(value, f"{'+' if sign else ''}.{digits}f")


def filled(template: str, numbers: Mapping[str, Any]) -> str:
    """The template with its fields filled in, "{tip:.3f}" by `number`.

    The members of a sequence are separated by commas.
    """
    return _Formatter().vformat(template, (), numbers)


class _Formatter(string.Formatter):
    def format_field(self, value: Any, format_spec: str) -> str:
        if isinstance(value, list | tuple):
            return ", ".join(self.format_field(item, format_spec) for item in value)
        if isinstance(value, str):
            return value
        return _typeset(value, format_spec)


def _typeset(value: float, spec: str) -> str:
    if not math.isfinite(value):
        return "–"
    text = format(value, spec)
    is_zero = not any(digit in text for digit in "123456789")
    return text.lstrip("+-") if is_zero else text.replace("-", "−")
