"""The code that pages cite, and the pages that show it.

    {test}`test_the_field_has_no_sources`        a test, found by its name
    {source}`optics.lens_trace.trace_backwards`  a module, or a function or class in it
    {api}`optics.vector_irradiance`              a name of the Python interface

These are the roles of `docs/roles.py`. The first two lead to pages with the code itself, which are
made here from the files. A name that is not found ends the build.
"""

from __future__ import annotations

import ast
import re
import textwrap
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

HOME = Path(__file__).resolve().parents[1]
_CITED = re.compile(r"\{(test|source)\}`([\w.]+)`")
_LONGEST = 60  # lines of code that are shown; more is read in its file


class Cited(NamedTuple):
    """A piece of code that pages cite.

    Attributes:
        name: as it is cited.
        file: path from the repository's root.
        line: where it begins.
        code: its text.
    """

    name: str
    file: str
    line: int
    code: str


def cited_names(kind: str, pages: Path = HOME / "docs") -> list[str]:
    """Names that pages cite with a role, sorted.

    Args:
        kind: "test" or "source".
        pages: folder of the pages.
    """
    texts = (path.read_text(encoding="utf-8") for path in sorted(pages.rglob("*.md")))
    return sorted({name for text in texts for role, name in _CITED.findall(text) if role == kind})


def cited_test(name: str) -> Cited:
    """The test of a name.

    Raises:
        LookupError: there is none.
    """
    for path in sorted((HOME / "tests").glob("test_*.py")):
        text = path.read_text(encoding="utf-8")
        if f"def {name}(" in text:
            return _piece(path, name, name)
    raise LookupError(f"no test is called {name}.")


def cited_source(name: str) -> Cited:
    """The module, or the function or class, of a dotted name.

    Raises:
        LookupError: there is none.
    """
    path = HOME.joinpath(*name.split("."))
    if path.with_suffix(".py").is_file():
        return _piece(path.with_suffix(".py"), name, "")
    if path.parent.with_suffix(".py").is_file():
        return _piece(path.parent.with_suffix(".py"), name, path.name)
    raise LookupError(f"no module or function is called {name}.")


def _piece(path: Path, name: str, part: str) -> Cited:
    text = path.read_text(encoding="utf-8")
    file = path.relative_to(HOME).as_posix()
    if not part:
        return Cited(name, file, 1, (ast.get_docstring(ast.parse(text)) or "").strip())
    for node in ast.parse(text).body:
        kinds = (ast.FunctionDef, ast.ClassDef)
        if isinstance(node, kinds) and node.name == part:
            first = min([node.lineno, *(one.lineno for one in node.decorator_list)])
            lines = text.splitlines()[first - 1 : node.end_lineno]
            if len(lines) > _LONGEST:
                lines = [*lines[:_LONGEST], "    ..."]
            return Cited(name, file, first, textwrap.dedent("\n".join(lines)))
    raise LookupError(f"{file} has no function or class {part}.")


def test_page() -> Iterator[str]:
    """The page of tests that other pages cite."""
    yield "# Tests that hold the theory\n"
    yield "Each test is the one that a formula of the [theory](../../theory/index.md) names. Run"
    yield "one with `pytest -k NAME`; those marked `slow` with `pytest -m slow -k NAME`.\n"
    for name in cited_names("test"):
        yield from _shown(cited_test(name))


def source_page() -> Iterator[str]:
    """The page of functions that other pages cite and the Python interface does not have."""
    yield "# Inner functions that the theory cites\n"
    yield "They are not part of the Python interface and may change. Of long ones the beginning is"
    yield "shown.\n"
    for name in cited_names("source"):
        yield from _shown(cited_source(name))


def _shown(cited: Cited) -> Iterator[str]:
    yield f"({label_of(cited.name)})="
    yield f"## {cited.name}\n\n`{cited.file}`, line {cited.line}\n"
    # Of a module the docstring is shown, which is no code.
    language = "text" if cited.name.replace(".", "/") + ".py" == cited.file else "python"
    yield f"```{language}\n{cited.code}\n```\n"


def label_of(name: str) -> str:
    """Label of a piece of code on its page."""
    return re.sub(r"[^a-z0-9]+", "-", f"cited {name}".lower())
