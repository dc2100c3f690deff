"""The code that pages cite, and the pages that show it.

    {test}`test_the_field_has_no_sources`        a test, found by its name
    {source}`optics.irradiance_edges.trace_backwards`  a module, or a function or class in it
    {api}`optics.vector_irradiance`              a name of the Python interface

These are the roles of `docs/roles.py`. The first two lead to pages with the code itself, which are
made here. A name that is not found ends the build.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

HOME = Path(__file__).resolve().parents[1]
_CITED = re.compile(r"\{(test|source)\}`([\w.]+)`")


def cited_names(kind: str, pages: Path = HOME / "docs") -> list[str]:
    """Names that pages cite with a role, sorted.

    Args:
        kind: "test" or "source".
        pages: folder of the pages.
    """
    texts = (path.read_text(encoding="utf-8") for path in sorted(pages.rglob("*.md")))
    return sorted({name for text in texts for role, name in _CITED.findall(text) if role == kind})


def cited_test(name: str) -> tuple[Path, str]:
    """The file of a test, and its name there.

    Raises:
        LookupError: there is none.
    """
    for path in sorted((HOME / "tests").glob("test_*.py")):
        if f"def {name}(" in path.read_text(encoding="utf-8"):
            return path, name
    raise LookupError(f"no test is called {name}.")


def cited_source(name: str) -> tuple[Path, str]:
    """The file of a dotted name, and the function or class there; empty for a module.

    Raises:
        LookupError: there is none.
    """
    path = HOME.joinpath(*name.split("."))
    if path.with_suffix(".py").is_file():
        return path.with_suffix(".py"), ""
    file = path.parent.with_suffix(".py")
    pattern = rf"^(def|class) {path.name}\b"
    if file.is_file() and re.search(pattern, file.read_text(encoding="utf-8"), re.MULTILINE):
        return file, path.name
    raise LookupError(f"no module or function is called {name}.")


def test_page() -> Iterator[str]:
    """The page of tests that other pages cite."""
    yield "# Tests that hold the theory\n"
    yield "Each test is the one that a formula of the [theory](../../theory/index.md) names. Run"
    yield "one with `pytest -k NAME`; those marked `slow` with `pytest -m slow -k NAME`.\n"
    for name in cited_names("test"):
        yield _shown(name, *cited_test(name))


def source_page() -> Iterator[str]:
    """The page of functions that other pages cite and the Python interface does not have."""
    yield "# Inner functions that the theory cites\n"
    yield "They are not part of the Python interface and may change.\n"
    for name in cited_names("source"):
        yield _shown(name, *cited_source(name))


def _shown(name: str, path: Path, part: str) -> str:
    file = path.relative_to(HOME).as_posix()
    # Of a module the docstring is shown, which is no code.
    code = f"```{{literalinclude}} ../../../{file}\n:pyobject: {part}\n```"
    if not part:
        text = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8")))
        code = f"```text\n{text}\n```"
    return f"({label_of(name)})=\n## {name}\n\n`{file}`\n\n{code}\n"


def label_of(name: str) -> str:
    """Label of a piece of code on its page."""
    return re.sub(r"[^a-z0-9]+", "-", f"cited {name}".lower())
