"""Names of files, and other text from files, as they are: without the markup of what shows them."""

from __future__ import annotations

import os

from rich.markup import escape


def in_figure(name: str) -> str:
    """A name as Matplotlib draws it.

    Between two dollar signs it would read mathematics, and a label that begins with an underscore
    would not be in the legend; a space before it cannot be seen.
    """
    literal = name.replace("$", r"\$")
    return f" {literal}" if literal.startswith("_") else literal


def in_terminal(name: str) -> str:
    """A name as Rich prints it; in square brackets it would read a style."""
    return escape(name)


def in_utf8(name: str | os.PathLike[str]) -> str:
    r"""A file's name for a file or a library that takes UTF-8: other bytes as \xe9."""
    return os.fsencode(name).decode("utf-8", "backslashreplace")
