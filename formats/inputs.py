"""Text, TOML, JSON and CSV that anyone may have written, and the error that says what is wrong.

Every fault is an InputError. The errors say what is wrong with the content; `in_file` adds the
file's name.
"""

import csv
import importlib.metadata
import json
import math
import os
import re
import stat
import tomllib
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError

_MAX_LINES_IN_MESSAGE = 3  # lines of a message that are shown


class InputError(ValueError):
    """A value that the caller can correct; the text names it, its unit, the rule and the remedy.

    The command line prints the text of an InputError and ends with 2. A ValueError of Python, NumPy
    or SciPy comes from a defect of ours and keeps its traceback: a frame's "math domain error" is
    no fault of the one who took the frame.
    """


def shortened(value: object) -> str:
    """A value from outside as a message shows it: as Python writes it, at most 200 characters."""
    try:
        return _cut(repr(value), 200)
    except ValueError:  # Python writes no whole number of more than 4,300 digits
        return f"{type(value).__name__} with very large numbers"


def _cut(text: str, longest: int = 300) -> str:
    return text if len(text) <= longest else f"{text[:longest]}…"


def at_most_three(problems: list[str]) -> str:
    """A message of at most three lines from any number of problems, one in a line."""
    more = len(problems) - _MAX_LINES_IN_MESSAGE
    if more <= 0:
        return "\n".join(problems)
    return "\n".join(
        [*problems[: _MAX_LINES_IN_MESSAGE - 1], f"and {more + 1} more problems like these."]
    )


MOST_BYTES = 2**26
"""Largest text file unless its reader says otherwise, 64 MiB: set.json of 100,000 stacks."""

_MAX_TOML_BYTES = 2**20  # our largest, a set's spec, has a few kB
_MAX_DOTS_IN_LINE = 100  # dots in a line of TOML that is read
_MAX_NESTING = 16  # levels of lists and tables; our formats have eight at most
_MAX_WHOLE_NUMBER = 2**63  # TOML's whole numbers, those of NumPy and of HDF5 have 64 bits
_SURROGATE = re.compile("[\ud800-\udfff]")  # alone it cannot be written


@contextmanager
def in_file(name: object, kind: type[InputError] = InputError) -> Iterator[None]:
    """Add a file's name, or any other place, to the InputErrors of a block.

    Args:
        name: of the file, with the line if there is one.
    """
    try:
        yield
    except InputError as error:
        raise kind(f"{name}: {error}") from error


def check_regular(
    path: Path, *, most_bytes: int | None = None, remedy: str = "Check that it is the right file."
) -> None:
    """Refuse what is no regular file: a pipe would wait for ever, a device may never end.

    Args:
        remedy: for a file of more than `most_bytes`.

    Raises:
        InputError: a folder, pipe, device or socket, a name that no file can have, or too large.
        OSError: there is no such file, or it may not be looked at.
    """
    try:
        found = path.stat()
    except ValueError as error:  # a NUL in the name
        raise InputError(f"no file can have the name {shortened(str(path))}.") from error
    if not stat.S_ISREG(found.st_mode):
        what = "a folder" if stat.S_ISDIR(found.st_mode) else "a pipe, device or socket"
        raise InputError(f"{what}, not a file. Give the path of a file.")
    if most_bytes is not None and found.st_size > most_bytes:
        raise InputError(f"larger than {most_bytes:,} bytes ({found.st_size:,}). {remedy}")


def read_data(path: Path, *, most_bytes: int) -> bytes:
    """The bytes of a regular file.

    Raises:
        InputError: too large, or not a regular file.
        OSError: the file cannot be read.
    """
    check_regular(path, most_bytes=most_bytes)
    with path.open("rb") as file:
        # Python takes the memory that is asked for, so ask for no more than there is.
        return file.read(os.fstat(file.fileno()).st_size)


def read_text(path: Path, *, most_bytes: int = MOST_BYTES) -> str:
    """The text of a file, UTF-8 with or without a byte order mark.

    Raises:
        InputError: too large, not a regular file, or not UTF-8.
        OSError: the file cannot be read.
    """
    try:
        return read_data(path, most_bytes=most_bytes).decode("utf-8-sig")
    except UnicodeDecodeError as fault:
        # Its text holds no data; the exception itself holds all of them.
        raise InputError(f"not a text file: {fault}.") from None


def read_toml(path: Path) -> dict[str, Any]:
    """The content of a TOML file.

    Raises:
        InputError: as `read_text` and `toml_in`.
        OSError: the file cannot be read.
    """
    return toml_in(read_text(path, most_bytes=_MAX_TOML_BYTES))


def toml_in(text: str) -> dict[str, Any]:
    """The content of a TOML text.

    Raises:
        InputError: not TOML, or as `check_values`.
    """
    # Python's parser takes the square of a key's parts: a minute for 50,000 of them.
    if any(line.count(".") > _MAX_DOTS_IN_LINE for line in text.split("\n")):
        raise InputError(
            f"not a TOML file: a line has more than {_MAX_DOTS_IN_LINE} dots. Break it up."
        )
    try:
        content = tomllib.loads(text)
    except RecursionError as fault:
        raise InputError("not a TOML file: nested too deeply to be read.") from fault
    except ValueError as fault:  # also a number of more digits than Python reads
        said = _cut(" ".join(f"{fault}".split()))
        raise InputError(f"not a TOML file: {said}{_faulty_line(text, said)}.") from fault
    check_values(content)
    return content


def _faulty_line(text: str, said: str) -> str:
    """The line that a parser names, and what to do about a decimal comma."""
    found = re.search(r"\(at line (\d+),", said)
    if found is None:
        return ""
    line = text.split("\n")[int(found[1]) - 1].strip()
    comma = re.search(r"=\s*[-+]?\d+,\d+\s*(?:#|$)", line)
    return f": {shortened(line)}" + (". Write numbers with a point" if comma else "")


def check_schema(found: object, history: Mapping[int, str], *, remedy: str) -> None:
    """Check the version of a format, for every format alike.

    Args:
        history: what changed with each version that can be read, the oldest first.

    Raises:
        InputError: the version is missing, unknown, or newer than this software.
    """
    if found is None:
        raise InputError(f"`schema` is missing. {remedy}")
    known = type(found) is int and found in history
    if known:
        return
    readable = f"{min(history)} to {max(history)}" if len(history) > 1 else f"{max(history)}"
    here = f"this eyespot ({importlib.metadata.version('eyespot')}) reads {readable}"
    newer = type(found) is int and found > max(history)
    way_out = "Install a newer eyespot." if newer else remedy
    raise InputError(f"schema is {shortened(found)}; {here}. {way_out}")


def check_values(content: object) -> None:
    """Refuse values that no file of ours has, before anything is computed from them.

    Args:
        content: of mappings, lists and plain values, as a reader of JSON or TOML returns it.

    Raises:
        InputError: nested too deeply, a whole number of more than 64 bits, or text that cannot be
            written again: with a NUL or a lone surrogate.
    """
    layer = [content]
    for _ in range(_MAX_NESTING + 1):
        below: list[object] = []
        for value in layer:
            if isinstance(value, Mapping):
                below += [*value.keys(), *value.values()]
            elif isinstance(value, list):
                below += value
            elif isinstance(value, str) and ("\0" in value or _SURROGATE.search(value)):
                raise InputError(
                    f"text must be Unicode without NUL; got {shortened(value)}. Remove the "
                    "character."
                )
            elif isinstance(value, int) and not -_MAX_WHOLE_NUMBER <= value < _MAX_WHOLE_NUMBER:
                raise InputError(
                    f"a whole number must have at most 64 bits; got {shortened(value)}."
                )
        if not below:
            return
        layer = below
    raise InputError(f"nested more than {_MAX_NESTING} levels deep.")


_Model = TypeVar("_Model", bound=BaseModel)


class Strict(BaseModel):
    """A part of a file: no value is converted to another type, and unknown keys are refused."""

    model_config = ConfigDict(strict=True, extra="forbid", frozen=True, allow_inf_nan=False)


def validated(model: type[_Model], content: object, *, remedy: str) -> _Model:
    """Content that fulfils a model.

    Args:
        content: mappings, lists and plain values, as a reader of JSON or TOML returns them.

    Raises:
        InputError: about the first key that breaks a rule.
    """
    try:
        return model.model_validate(content)
    except ValidationError as fault:
        raise InputError(f"{_fault(fault)}. {remedy}") from fault


_RULES = {
    "string_type": "must be text",
    "string_too_short": "must not be empty",
    "list_type": "must be a list",
    "tuple_type": "must be a list",
    "dict_type": "must be an object",
    "model_type": "must be an object",
    "float_type": "must be a finite number",
    "finite_number": "must be a finite number",
    "int_type": "must be a whole number",
    "int_parsing_size": "must be a whole number of at most 64 bits",
    "too_long": "must have at most {max_length} values",
    "too_short": "must have at least {min_length} values",
    "greater_than_equal": "must be at least {ge:g}",
    "greater_than": "must be above {gt:g}",
    "less_than_equal": "must be at most {le:g}",
    "less_than": "must be below {lt:g}",
    "none_required": "must be null",
    "literal_error": "must be {expected}",
    "value_error": "{error}",
}
"""Pydantic's kinds of fault in our words; others have pydantic's."""


def _fault(fault: ValidationError) -> str:
    faults = fault.errors()
    misnamed = [
        _key(each["loc"]) for each in faults if each["type"] in ("missing", "extra_forbidden")
    ]
    first = faults[0]
    if misnamed and not (first["loc"] and isinstance(first["loc"][-1], int)):
        names = (name if name.isprintable() else repr(name) for name in sorted(misnamed))
        return f"missing or unknown: {_cut(', '.join(names))}"
    if first["type"] == "missing":
        rule = f"{_key(first['loc'][:-1])} is too short"
    else:
        ours = _RULES.get(first["type"])
        said = ours.format(**first.get("ctx", {})) if ours else first["msg"]
        if first["type"] == "value_error" and not first["loc"]:
            return said  # it names the keys that do not belong together, and their values
        rule = f"{_key(first['loc'])} {_cut(said)}"
    return f"{rule}; got {shortened(first['input'])}"


def _key(place: tuple[int | str, ...]) -> str:
    return _cut(".".join(map(str, place))) or "the file"


def object_in(text: str) -> dict[str, Any]:
    """The JSON object in a text.

    NaN and infinity are read, so that a model can name the key that has them.

    Raises:
        InputError: not JSON, not an object, or as `formats.inputs.check_values`.
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


MOST_CSV_BYTES = 2**28
"""Largest CSV file, 256 MiB."""
MOST_ROWS = 2**20
"""Most rows, each of which takes up to 1 kB of memory: the robot's poses for 87 minutes."""


def csv_rows(
    path: Path, *, check: Callable[[Collection[str]], None]
) -> Iterator[tuple[dict[str, str], str]]:
    """The rows of a CSV file with a header, each with its place for messages.

    Args:
        check: refuses a header with an InputError.

    Raises:
        InputError: not CSV, too large, or a row of another length than the header; the message
            names file and line.
        OSError: the file cannot be read.
    """
    with in_file(path):
        check_regular(path, most_bytes=MOST_CSV_BYTES, remedy="Split it, or write fewer rows.")
    with path.open(newline="", encoding="utf-8-sig") as file:
        rows = csv.DictReader(file, strict=True)
        try:
            with in_file(f"{path}, line 1"):
                check(rows.fieldnames or ())
            for number, row in enumerate(rows):
                where = f"{path}, line {rows.line_num}"
                if None in row or None in row.values():
                    width = len(rows.fieldnames or ())
                    raise InputError(f"{where}: {width} cells expected, as in the header.")
                if number >= MOST_ROWS:
                    raise InputError(f"{path}: more than {MOST_ROWS:,} rows. Split the file.")
                yield row, where
        except csv.Error as error:
            raise InputError(f"{path}: not a CSV file: {error}.") from error
        except UnicodeDecodeError as error:
            raise InputError(f"{path}: not a text file: {error}.") from None


_NUMBER = re.compile(r"[-+]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][-+]?[0-9]+)?|nan|NaN")


def number_in(cell: str, name: str) -> float:
    """The finite number in a cell; NaN in an empty one.

    Raises:
        InputError: not a number, or not finite; without the place.
    """
    value = math.nan
    if cell:
        # Python would also read 1_0 and digits of other scripts.
        value = float(cell) if _NUMBER.fullmatch(cell.strip(" ")) else math.inf
    if math.isinf(value):
        raise InputError(f"{name} must be a finite number; got {shortened(cell)}.")
    return value


FOLDER_NAME = r"^[A-Za-z0-9][A-Za-z0-9._-]{0,79}$"
"""Pattern of a name that becomes a folder: no separator, and no dot in front."""

_MAX_NAME_LENGTH = 100  # characters; a name in a tar file may not have more


def inside(folder: Path, name: str) -> Path:
    """The path of a name that a file contains, if it lies inside the folder.

    Whoever sends a stack or a set writes the names in it. A name that leaves the folder would read
    or pack a file of the one who opens it.

    Args:
        name: with `/` between its parts; the file or folder need not exist.

    Raises:
        InputError: the name is absolute, has `..`, `.`, an empty part, a backslash or NUL; leads
            out of the folder by a symbolic link; or is neither a file nor a folder.
    """
    parts = name.split("/")
    wrong = any(part in ("", ".", "..") for part in parts) or re.search(r"[\\\0]", name)
    if wrong or len(name) > _MAX_NAME_LENGTH:
        raise InputError(
            f"a name of a file must stay within its folder: relative, without `..` and backslash; "
            f"got {shortened(name)}. Do not use files from this sender unseen."
        )
    path = Path(folder, *parts)
    try:
        if not path.resolve().is_relative_to(Path(folder).resolve()):
            raise InputError(
                f"{shortened(name)} is a link that leads out of {folder}. Replace it by the file."
            )
        kind = path.stat().st_mode
    except FileNotFoundError:
        return path
    except RuntimeError as error:  # links that lead to each other
        raise InputError(f"{shortened(name)} is a link without an end. Remove it.") from error
    if not (stat.S_ISREG(kind) or stat.S_ISDIR(kind)):
        raise InputError(f"{shortened(name)} is a pipe, device or socket, not a file. Remove it.")
    return path


def in_utf8(name: str | os.PathLike[str]) -> str:
    r"""A file's name for a file or a library that takes UTF-8: other bytes as \xe9."""
    return os.fsencode(name).decode("utf-8", "backslashreplace")
