"""Formats of files as pydantic models: what is wrong with a file's content, in our words."""

from __future__ import annotations

from typing import TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError

from optics.input_error import InputError, shortened

_Model = TypeVar("_Model", bound=BaseModel)


class Strict(BaseModel):
    """A part of a file: no value is converted to another type, and unknown keys are refused."""

    model_config = ConfigDict(strict=True, extra="forbid", frozen=True, allow_inf_nan=False)


def validated(model: type[_Model], content: object, *, remedy: str) -> _Model:
    """Content that fulfils a model.

    Args:
        model: what the file must be.
        content: mappings, lists and plain values, as a reader of JSON or TOML returns them.
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
    "int_parsing_size": "must be a whole number of at most 64 bits",
    "greater_than_equal": "must be at least {ge:g}",
    "greater_than": "must be above {gt:g}",
    "less_than_equal": "must be at most {le:g}",
    "less_than": "must be below {lt:g}",
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
    if misnamed and not (first["loc"] and isinstance(first["loc"][-1], int)):
        return f"missing or unknown: {_cut(', '.join(sorted(misnamed)))}"
    if first["type"] == "missing":
        rule = f"{_key(first['loc'][:-1])} is too short"
    else:
        ours = _RULES.get(first["type"])
        said = ours.format(**first.get("ctx", {})) if ours else first["msg"]
        rule = f"{_key(first['loc'])} {_cut(said)}"
    return f"{rule}; got {shortened(first['input'])}"


def _key(place: tuple[int | str, ...]) -> str:
    return _cut(".".join(map(str, place))) or "the file"


def _cut(text: str) -> str:
    return text if len(text) <= 300 else f"{text[:300]}…"
