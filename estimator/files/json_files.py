"""Reads JSON that anyone may have written, and checks it against a pydantic model.

Every fault is a ValueError that names the key, the rule, the value and the remedy; the readers add
the file's name.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError

from optics import InputError

_Model = TypeVar("_Model", bound=BaseModel)

MOST_BYTES = 2**26
"""Largest file, 64 MiB: the manifest of a stack of 200,000 images."""

_DEEPEST = 16  # levels of lists and objects; our formats have five at most
_LONGEST = 200  # characters of a wrong value in a message


class Strict(BaseModel):
    """A part of a file: no value is converted to another type, and unknown keys are refused."""

    model_config = ConfigDict(strict=True, extra="forbid", frozen=True, allow_inf_nan=False)


def read_text(path: Path) -> str:
    """The text of a file, UTF-8 with or without a byte order mark.

    Raises:
        InputError: too large, or not UTF-8.
        OSError: the file cannot be read.
    """
    with path.open("rb") as file:
        data = file.read(MOST_BYTES + 1)
    if len(data) > MOST_BYTES:
        raise InputError(f"larger than {MOST_BYTES} bytes. Check that it is the right file.")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as fault:
        raise InputError(f"not a text file: {fault}.") from fault


def object_in(text: str) -> dict[str, Any]:
    """The JSON object in a text.

    NaN and infinity are read, so that a model can name the key that has them.

    Raises:
        InputError: not JSON, not an object, or nested too deeply.
    """
    try:
        content = json.loads(text)
    except RecursionError as fault:
        raise InputError(f"nested more than {_DEEPEST} levels deep.") from fault
    except ValueError as fault:  # also a number of more digits than Python reads
        raise InputError(f"not JSON ({fault}). Check that the file is whole.") from fault
    if not isinstance(content, dict):
        raise InputError(f"not a JSON object, but {_short(content)}.")
    if _is_deeper(content, _DEEPEST):
        raise InputError(f"nested more than {_DEEPEST} levels deep.")
    return content


def check_schema(content: dict[str, Any], known: int, *, remedy: str) -> None:
    """Check the version of a format.

    Raises:
        InputError: `schema` is missing or not the known one.
    """
    if "schema" not in content:
        raise InputError("`schema` is missing.")
    if content["schema"] != known:
        raise InputError(
            f"schema is {_short(content['schema'])}; this version reads {known}. {remedy}"
        )


def validated(model: type[_Model], content: object, *, remedy: str) -> _Model:
    """Content that fulfils a model.

    Args:
        model: what the file must be.
        content: as `object_in` returns it.
        remedy: sentence that ends the message of an error.

    Raises:
        InputError: about the first key that breaks a rule.
    """
    try:
        return model.model_validate(content)
    except ValidationError as fault:
        raise InputError(f"{_said(fault)}. {remedy}") from fault


_RULES = {
    "string_type": "must be text",
    "list_type": "must be a list",
    "tuple_type": "must be a list",
    "dict_type": "must be an object",
    "model_type": "must be an object",
    "float_type": "must be a finite number",
    "finite_number": "must be a finite number",
    "int_type": "must be a whole number",
    "greater_than_equal": "must be at least {ge:g}",
    "none_required": "must be null",
    "value_error": "{error}",
}
"""Pydantic's kinds of fault in our words; others have pydantic's."""


def _said(fault: ValidationError) -> str:
    faults = fault.errors()
    misnamed = [
        _key(each["loc"]) for each in faults if each["type"] in ("missing", "extra_forbidden")
    ]
    first = faults[0]
    if misnamed and not isinstance(first["loc"][-1], int):
        return f"missing or unknown: {', '.join(sorted(misnamed))}"
    if first["type"] == "missing":
        rule = f"{_key(first['loc'][:-1])} is too short"
    else:
        ours = _RULES.get(first["type"])
        said = ours.format(**first.get("ctx", {})) if ours else first["msg"]
        rule = f"{_key(first['loc'])} {said}"
    return f"{rule}; got {_short(first['input'])}"


def _key(place: tuple[int | str, ...]) -> str:
    return ".".join(map(str, place)) or "the file"


def _short(value: object) -> str:
    text = repr(value)
    return text if len(text) <= _LONGEST else f"{text[:_LONGEST]}…"


def _is_deeper(content: object, levels: int) -> bool:
    layer = [content]
    for _ in range(levels):
        layer = [
            child
            for value in layer
            if isinstance(value, dict | list)
            for child in (value.values() if isinstance(value, dict) else value)
        ]
        if not layer:
            return False
    return True
