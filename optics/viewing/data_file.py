"""Reads the files of eyes and viewing lenses, those of the package and those of a user."""

from __future__ import annotations

from pathlib import Path
from typing import TypeVar

from optics import InputError, Strict, check_schema, in_file, read_toml, shortened, validated

_HISTORY = {1: "the first format"}
_HERE = Path(__file__).parent

_Format = TypeVar("_Format", bound=Strict)


def names_in(folder: str) -> tuple[str, ...]:
    """Names of the files that come with the package."""
    return tuple(sorted(path.stem for path in (_HERE / folder).glob("*.toml")))


def read_data_file(format_: type[_Format], folder: str, name_or_path: str | Path) -> _Format:
    """Read a TOML file by the name that it has in the package, or by its path.

    Args:
        format_: of the content; `schema` and `provenance` are checked here.
        folder: of the package's own files, "eyes" or "lenses".
        name_or_path: a name of `names_in(folder)`, or the path of a `.toml` file.

    Raises:
        InputError: no such file, an unknown, missing or wrong key.
    """
    path = Path(name_or_path)
    if path.suffix != ".toml":
        path = _HERE / folder / f"{name_or_path}.toml"
    with in_file(f"{folder[:-1]} {shortened(str(name_or_path))}"):
        try:
            content = read_toml(path)
        except FileNotFoundError as error:
            raise InputError(
                f"no such file. Known names: {', '.join(names_in(folder))}; or give the path of a "
                ".toml file."
            ) from error
        remedy = f"Compare the file with those in optics/viewing/{folder}."
        check_schema(content.pop("schema", None), _HISTORY, remedy=remedy)
        if not isinstance(content.pop("provenance", None), str):
            raise InputError(f"`provenance`, the source of the numbers, is missing. {remedy}")
        return validated(format_, content, remedy=remedy)
