"""Files of settings that people write (TOML): changes by key, the template, and what is wrong.

Scene files and rig files share this: every key has a default and a meaning, `--set KEY=VALUE`
changes one, and an unknown key names the nearest known one.
"""

import difflib
import math
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from typing import Annotated, Any, get_args

import tomli_w
from pydantic import AfterValidator, BaseModel, Field, ValidationError
from pydantic import Strict as StrictType

from eyespot.formats.inputs import InputError, at_most_three, shortened, toml_in

_MAX_KEY_LENGTH = 100  # characters; ours have 40 at most

SigmaKey = Annotated[float, Field(ge=0, le=1e6)]
ShareKey = Annotated[float, Field(ge=0, lt=1)]
NumberKey = Annotated[float, Field(ge=-1e6, le=1e6)]
PairKey = Annotated[tuple[NumberKey, NumberKey], StrictType(False)]
VectorKey = Annotated[tuple[NumberKey, NumberKey, NumberKey], StrictType(False)]


def _unit(vector: tuple[float, float, float]) -> tuple[float, float, float]:
    length = math.hypot(*vector)
    if not length > 0:
        raise InputError(f"must not be the zero vector; got {list(vector)}")
    x, y, z = (part / length for part in vector)
    return x, y, z


DirectionKey = Annotated[VectorKey, AfterValidator(_unit)]


def parsed_change(change: str) -> dict[str, Any]:
    """A change "table.key=value" as nested tables; a value that is not TOML is a string.

    Raises:
        InputError: the change is not "key=value".
    """
    key, equals, text = (part.strip() for part in change.partition("="))
    if not (key and equals) or len(key) > _MAX_KEY_LENGTH:
        raise InputError(
            f"a change must have the form table.key=value; got {shortened(change)}. Name a key of "
            "the file."
        )
    try:
        value = toml_in(f"value = {text}")["value"]
    except InputError:
        value = text
    return nested(key.split("."), value)


def change_of(key: str, value: Any) -> str:
    """A change as text, which `parsed_change` reads."""
    return f"{key}={_inline(value)}"


def _inline(value: Any) -> str:
    """A value as TOML, a table in one line."""
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{name} = {_inline(own)}" for name, own in value.items()) + " }"
    return tomli_w.dumps({"value": value}).partition("=")[2].strip()


def nested(path: Sequence[str], value: Any) -> dict[str, Any]:
    """A value in the tables that lead to it."""
    for part in reversed(path):
        value = {part: value}
    return value


def by_dotted_name(table: Mapping[str, Any], *, whole: Collection[str] = ()) -> dict[str, Any]:
    """The values of nested tables by dotted key; a table with one key of `whole` is a value."""
    found: dict[str, Any] = {}
    for name, value in table.items():
        if isinstance(value, Mapping) and not value.keys() & set(whole):
            below = by_dotted_name(value, whole=whole)
            found |= {f"{name}.{key}": own for key, own in below.items()}
        else:
            found[name] = value
    return found


def merged(content: Mapping[str, Any], change: Mapping[str, Any]) -> dict[str, Any]:
    """The content with the changed values."""
    found = dict(content)
    for key, value in change.items():
        old = found.get(key)
        if isinstance(value, Mapping) and isinstance(old, Mapping):
            value = merged(old, value)
        found[key] = value
    return found


def first_line(model: type[BaseModel]) -> str:
    """The first line of a table's docstring."""
    return (model.__doc__ or "").splitlines()[0]


def table_lines(name: str, model: type[BaseModel]) -> Iterator[str]:
    """A table of a template: what it is, and each key with its default and its meaning."""
    yield from ("", f"# {first_line(model)}", f"[{name}]")
    for key, field in model.model_fields.items():
        yield documented(key, field)


def documented(key: str, field: Any) -> str:
    """A key with its default; one without a default is a comment that shows its form."""
    named, default = field.alias or key, field.default
    choices = get_args(field.annotation)
    names = [repr(c) for c in choices if isinstance(c, str | int)]
    notes = [n for n in (" | ".join(names[len(names) == 1 :]), field.description) if n]
    if default is None or field.default_factory is not None:
        (example,) = field.examples or ("",)
        return f"# {named} = {example}  # {'. '.join(notes)}"
    plain = default.model_dump() if isinstance(default, BaseModel) else default
    text = tomli_w.dumps({named: plain}).strip() if plain != {} else f"{named} = {{}}"
    text = text.replace("\n    ", " ").replace(",\n]", " ]")
    return f"{text}  # {'. '.join(notes)}" if notes else text


def problems_of(error: ValidationError, where: str, model: type[BaseModel]) -> str:
    """What pydantic found wrong in a file, in at most three lines."""

    def sentence(problem: Any) -> str:
        # Of a key that takes several kinds of values, pydantic adds the kind, such as "tuple[...]".
        path = [part for part in problem["loc"] if "[" not in str(part)]
        return problem_sentence(problem, path, siblings=lambda: _siblings(model, path))

    return at_most_three([f"{where}: {sentence(problem)}" for problem in error.errors()])


def _siblings(model: type[BaseModel], location: Sequence[int | str]) -> list[str]:
    """The known keys of the table that contains a key."""
    for part in location[:-1]:
        field = model.model_fields.get(str(part))
        kinds = (type(field.default), *get_args(field.annotation)) if field else ()
        tables = [k for k in kinds if isinstance(k, type) and issubclass(k, BaseModel)]
        if not tables:
            return []
        model = tables[0]
    return [field.alias or name for name, field in model.model_fields.items()]


def problem_sentence(
    problem: Any, path: Sequence[int | str], *, siblings: Callable[[], list[str]]
) -> str:
    """A sentence for one error that pydantic found in a file.

    Args:
        problem: an item of `ValidationError.errors()`.
        path: path of the key in the file.
        siblings: gives the known keys of that table, to suggest one for an unknown key.
    """
    where = shortened(".".join(str(part) for part in path))[1:-1]
    if problem["type"] == "extra_forbidden":
        key = str(path[-1])[:_MAX_KEY_LENGTH]  # a comparison takes the product of the lengths
        near = difflib.get_close_matches(key, siblings(), n=1)
        hint = f"; did you mean {near[0]!r}?" if near else ""
        return f"unknown key {where!r}{hint}"
    if problem["type"] == "value_error":  # our own message, which gives the value
        return ": ".join(filter(None, [where, problem["msg"].removeprefix("Value error, ")]))
    return f"{where}: {problem['msg']}; got {shortened(problem['input'])}"
