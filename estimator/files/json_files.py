"""Reads JSON that anyone may have written; every fault is an InputError.

The readers add the file's name.
"""

from __future__ import annotations

import json
from typing import Any

from optics import InputError, check_values, shortened


def object_in(text: str) -> dict[str, Any]:
    """The JSON object in a text.

    NaN and infinity are read, so that a model can name the key that has them.

    Raises:
        InputError: not JSON, not an object, or as `optics.check_values`.
    """
    try:
        content = json.loads(text)
    except RecursionError as fault:
        raise InputError("not JSON: nested too deeply to be read.") from fault
    except ValueError as fault:  # also a number of more digits than Python reads
        raise InputError(f"not JSON ({fault}). Check that the file is whole.") from fault
    if not isinstance(content, dict):
        raise InputError(f"not a JSON object, but {shortened(content)}.")
    check_values(content)
    return content
