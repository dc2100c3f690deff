"""Reads text and TOML that anyone may have written; every fault is an InputError.

The errors say what is wrong with the content; `in_file` adds the file's name.
"""

from __future__ import annotations

import importlib.metadata
import stat
import tomllib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from optics.input_error import InputError, shortened

MOST_BYTES = 2**26
"""Largest text file unless its reader says otherwise, 64 MiB: set.json of 100,000 stacks."""

_MOST_TOML_BYTES = 2**20  # our largest, a set's spec, has a few kB
_MOST_DOTS = 100  # of a line
_DEEPEST = 16  # levels of lists and tables; our formats have eight at most
_LARGEST = 2**63  # TOML's whole numbers, those of NumPy and of HDF5 have 64 bits


@contextmanager
def in_file(name: object, kind: type[InputError] = InputError) -> Iterator[None]:
    """Add a file's name, or any other place, to the InputErrors of a block.

    Args:
        name: of the file, with the line if there is one.
        kind: of the error.
    """
    try:
        yield
    except InputError as error:
        raise kind(f"{name}: {error}") from error


def check_regular(path: Path) -> int:
    """Refuse what is no regular file: a pipe would wait for ever, a device may never end.

    Returns:
        Size of the file, bytes.

    Raises:
        InputError: a folder, pipe, device or socket, or a name that no file can have.
        OSError: there is no such file, or it may not be looked at.
    """
    try:
        found = path.stat()
    except ValueError as error:  # a NUL in the name
        raise InputError(f"no file can have the name {shortened(str(path))}.") from error
    if not stat.S_ISREG(found.st_mode):
        what = "a folder" if stat.S_ISDIR(found.st_mode) else "a pipe, device or socket"
        raise InputError(f"{what}, not a file. Give the path of a file.")
    return found.st_size


def read_data(path: Path, *, most_bytes: int) -> bytes:
    """The bytes of a regular file.

    Raises:
        InputError: too large, or not a regular file.
        OSError: the file cannot be read.
    """
    size = check_regular(path)
    if size > most_bytes:
        raise InputError(
            f"larger than {most_bytes:,} bytes ({size:,}). Check that it is the right file."
        )
    with path.open("rb") as file:
        return file.read(most_bytes)


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
    return toml_in(read_text(path, most_bytes=_MOST_TOML_BYTES))


def toml_in(text: str) -> dict[str, Any]:
    """The content of a TOML text.

    Raises:
        InputError: not TOML, or as `check_values`.
    """
    # Python's parser takes the square of a key's parts: a minute for 50,000 of them.
    if any(line.count(".") > _MOST_DOTS for line in text.split("\n")):
        raise InputError(f"not a TOML file: a line has more than {_MOST_DOTS} dots. Break it up.")
    try:
        content = tomllib.loads(text)
    except RecursionError as fault:
        raise InputError("not a TOML file: nested too deeply to be read.") from fault
    except ValueError as fault:  # also a number of more digits than Python reads
        raise InputError(f"not a TOML file: {_said(fault)}.") from fault
    check_values(content)
    return content


def check_schema(found: object, history: Mapping[int, str], *, remedy: str) -> None:
    """Check the version of a format, for every format alike.

    Args:
        found: the file's version; None if it has none.
        history: what changed with each version that can be read, the oldest first.
        remedy: sentence about a file whose version never existed.

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
    for _ in range(_DEEPEST + 1):
        below: list[object] = []
        for value in layer:
            if isinstance(value, Mapping):
                below += [*value.keys(), *value.values()]
            elif isinstance(value, list):
                below += value
            elif isinstance(value, str):
                _check_text(value)
            elif isinstance(value, int) and not -_LARGEST <= value < _LARGEST:
                raise InputError(
                    f"a whole number must have at most 64 bits; got {shortened(value)}."
                )
        if not below:
            return
        layer = below
    raise InputError(f"nested more than {_DEEPEST} levels deep.")


def _check_text(text: str) -> None:
    if "\0" in text or not (text.isascii() or _is_unicode(text)):
        raise InputError(
            f"text must be Unicode without NUL; got {shortened(text)}. Remove the character."
        )


def _is_unicode(text: str) -> bool:
    try:
        text.encode()
    except UnicodeEncodeError:
        return False
    return True


def _said(fault: ValueError) -> str:
    """A reader's own words; it may quote a whole key."""
    text = " ".join(f"{fault}".split())
    return text if len(text) <= 200 else f"{text[:200]}…"
