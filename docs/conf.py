"""Sphinx's settings for the site: `make docs` builds it into out/docs."""

import importlib.metadata
import logging
import os
import re
import sys
from pathlib import Path
from threading import Thread
from typing import Any

import myst_nb.core.render
import nbformat
from jupyter_cache import get_cache
from jupyter_cache.executors import load_executor
from myst_nb.core.utils import coalesce_streams

import eyespot  # noqa: F401  first: what it lets JAX keep is compiled once for all pages and examples

_HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(_HERE.parent))
# Pages call `eyespot`, which is beside this Python.
os.environ["PATH"] = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
os.environ["COLUMNS"] = "100"
os.environ["OPENBLAS_NUM_THREADS"] = "1"  # more wait for each other; read once, before NumPy

project = "eyespot"
author = "The eyespot developers"
copyright = author
release = version = importlib.metadata.version("eyespot")

extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.napoleon",
    "sphinx.ext.viewcode",
    "sphinx_copybutton",
    "sphinx_gallery.gen_gallery",
    "sphinx-mathjax-offline",
]
exclude_patterns = ["gallery/**", "auto_gallery/**/*.ipynb", "jupyter_execute"]
html_theme = "furo"
html_title = "eyespot"
html_static_path = ["static"]
html_css_files = ["site.css"]
default_role = "code"  # as in our docstrings

myst_enable_extensions = ["dollarmath", "amsmath", "deflist", "colon_fence"]
myst_heading_anchors = 3
nb_execution_mode = "cache"  # a page runs again only if its code changed
nb_execution_timeout = 900
nb_execution_raise_on_error = True
nb_merge_streams = True
suppress_warnings = ["mystnb.unknown_mime_type"]

autodoc_member_order = "bysource"
autodoc_typehints = "signature"
napoleon_google_docstring = True
napoleon_numpy_docstring = False
napoleon_use_ivar = True

copybutton_prompt_text = r">>> |\.\.\. |\$ "
copybutton_prompt_is_regexp = True

sphinx_gallery_conf = {
    "examples_dirs": ["gallery"],
    "gallery_dirs": ["auto_gallery"],
    "filename_pattern": r"/plot_\w+\.py$",  # others are shown, and not run
    "ignore_pattern": r"__init__\.py",
    "download_all_examples": False,
    "show_memory": False,
    "remove_config_comments": True,
    "reset_modules": ("matplotlib",),
    "subsection_order": ["gallery/scenes", "gallery/lenses", "gallery/models", "gallery/reading"],
    "within_subsection_order": "FileNameSortKey",
    "abort_on_example_error": True,
}


_VERBATIM = re.compile(
    r"(?<![\\$])\$[^$]+\$|`+[^`]+`+|^ *>>>[^\n]*(?:\n *\S[^\n]*)*", flags=re.DOTALL | re.MULTILINE
)


def _as_rst(app: Any, what: str, name: str, obj: object, options: Any, lines: list[str]) -> None:
    """Docstrings are plain text with `code` and $formulas$; autodoc reads reStructuredText."""
    if what == "module":
        # The first paragraph says what the package is, the rest is its indented map.
        head, *rest = "\n".join(lines).split("\n\n", 1)
        lines[:] = [*head.split("\n"), "", ".. code-block:: text", ""]
        lines += [f"    {line}" for line in (rest[0] if rest else "").split("\n")]
        return
    text, last, parts = "\n".join(lines), 0, []
    for match in _VERBATIM.finditer(text):
        parts += [_escaped(text[last : match.start()]), _formula_or_code(match[0])]
        last = match.end()
    lines[:] = "".join([*parts, _escaped(text[last:])]).split("\n")


def _escaped(text: str) -> str:
    """|SO| is a length, and *batch a shape: neither is markup here."""
    return re.sub(r"(?<!\\)([*|])", r"\\\1", text)


def _formula_or_code(text: str) -> str:
    return f":math:`{text[1:-1]}`" if text.startswith("$") else text


def _whole_streams(outputs: list[Any]) -> list[Any]:
    """Outputs of a cell with each stream in one piece.

    IPython reads a program's output in pieces of 100 bytes, and myst-nb ends a line after each.
    """
    streams: dict[str, Any] = {}
    whole = []
    for output in outputs:
        name = output.get("name", "")
        if output["output_type"] == "stream" and name in streams:
            streams[name]["text"] += output["text"]
            continue
        if output["output_type"] == "stream":
            streams[name] = output
        whole.append(output)
    merged: list[Any] = coalesce_streams(whole)
    return merged


myst_nb.core.render.coalesce_streams = _whole_streams


def _cache_folder(app: Any) -> str:
    return str(app.outdir.parent / ".jupyter_cache")


def _run_pages(folder: str) -> None:
    """Run the cells of pages that changed; myst-nb finds their outputs, and reports failures."""
    # Every bash starts with these, so a cell fails with any of its commands.
    os.environ["SHELLOPTS"] = "errexit:nounset:pipefail"
    for name in ("jupyter_cache", "traitlets"):
        logging.getLogger(name).setLevel(logging.WARNING)
    cache = get_cache(folder)
    for page in sorted(_HERE.rglob("*.md")):
        if "{code-cell}" in page.read_text(encoding="utf-8"):
            cache.add_nb_to_project(str(page), read_data={"type": "plugin", "name": "myst_nb_md"})
    load_executor("local-serial", cache).run_and_cache(timeout=nb_execution_timeout)


_INCLUDED = re.compile(r"```\{literalinclude\} (\S+)\n(?::[^\n]*\n)*```")
_LINK_TO_PAGE = re.compile(r"!?\[([^]]+)\]\((?!https?:)[^)]+\)")


def _offer_notebook(app: Any, page: str, template: str, context: Any, doctree: Any) -> None:
    """Offer a tutorial as a notebook, which needs neither the site nor its folders."""
    if not page.startswith("tutorials/"):
        return
    # myst-nb writes it here, and leaves the outputs in its cache.
    written = app.outdir.parent / "jupyter_execute" / f"{page}.ipynb"
    notebook = nbformat.read(written, as_version=4)
    _, notebook = get_cache(_cache_folder(app)).merge_match_into_notebook(notebook)
    # The cell that is not shown goes into the site's folders.
    notebook.cells = [
        cell for cell in notebook.cells if "remove-cell" not in cell.metadata.get("tags", [])
    ]
    folder = (_HERE / page).parent
    for cell in notebook.cells:
        if cell.cell_type == "markdown":
            text = _INCLUDED.sub(
                lambda match: f"```text\n{(folder / match[1]).read_text('utf-8')}```", cell.source
            )
            cell.source = _LINK_TO_PAGE.sub(r"\1", text)
        else:
            cell.outputs = _whole_streams(cell.outputs)
    target = Path(app.outdir) / f"{page}.ipynb"
    target.parent.mkdir(parents=True, exist_ok=True)
    nbformat.write(notebook, target)
    link = f'<p><a href="{target.name}" download>This page as a notebook</a></p>'
    context["body"] = context["body"].replace("</h1>", f"</h1>\n{link}", 1)


def setup(app: Any) -> None:
    """Write the pages that come from the code, and read docstrings as they are meant."""
    from docs.generated import write_pages

    write_pages(_HERE / "reference" / "generated")
    app.connect("autodoc-process-docstring", _as_rst)
    app.connect("html-page-context", _offer_notebook)
    # Beside the gallery's examples, as neither uses two cores.
    pages = Thread(target=_run_pages, args=(_cache_folder(app),))
    pages.start()
    app.connect("env-before-read-docs", lambda *_: pages.join())
