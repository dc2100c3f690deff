"""Who may import whom, and what an import must not load."""

from __future__ import annotations

import ast
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import pytest

HOME = Path(__file__).resolve().parents[2]
PACKAGES = ("formats", "optics", "scenes", "estimator", "calibration", "benchmarks")

MAY_IMPORT_OF_OURS = {
    "formats": {"optics"},
    "optics": {"formats"},
    "estimator": {"formats", "optics"},
    "scenes": {"formats", "optics", "estimator"},
    "calibration": {"formats", "optics", "estimator"},
    "benchmarks": set(PACKAGES),
}
MAY_BE_IMPORTED_BY = {
    "cv2": {"formats", "estimator", "scenes", "benchmarks"},
    "mitsuba": {"scenes"},
    "drjit": {"scenes"},
    "optimistix": {"optics", "calibration", "benchmarks"},
    "jax": {"optics", "calibration", "benchmarks"},
    "jaxlib": {"optics", "calibration", "benchmarks"},
    "equinox": {"optics", "calibration", "benchmarks"},
    "lineax": {"calibration"},
    "optax": {"benchmarks"},
}

# Where a spot becomes a distance, and the microscope that the others see the eye through.
LATE_USERS_OF_OPTICS = {
    "estimator/distance/cone.py",
    "estimator/distance/lens_range.py",
    "estimator/distance/ranger.py",
    "estimator/distance/tilted_cone.py",
    "formats/microscope.py",
}


class Import(NamedTuple):
    """An imported module: its dotted name, its line, whether a function holds the statement, and
    the names that are taken from it.
    """

    module: str
    line: int
    late: bool
    names: tuple[str, ...] = ()


def imports_of(source: str) -> Iterator[Import]:
    """Every absolute import in the source, `importlib.import_module("...")` among them.

    What stands under `if TYPE_CHECKING:` is read by type checkers and imported by nobody.
    """

    def visit(node: ast.AST, late: bool) -> Iterator[Import]:
        if isinstance(node, ast.If) and ast.unparse(node.test).endswith("TYPE_CHECKING"):
            for otherwise in node.orelse:
                yield from visit(otherwise, late)
            return
        if isinstance(node, ast.Import):
            for alias in node.names:
                yield Import(alias.name, node.lineno, late)
        elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
            names = tuple(alias.name for alias in node.names)
            yield Import(node.module, node.lineno, late, names)
        elif isinstance(node, ast.Call) and node.args and isinstance(node.args[0], ast.Constant):
            called = ast.unparse(node.func)
            if called in {"importlib.import_module", "import_module", "__import__"}:
                yield Import(str(node.args[0].value), node.lineno, late)
        late = late or isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda)
        for child in ast.iter_child_nodes(node):
            yield from visit(child, late)

    yield from visit(ast.parse(source), late=False)


def imports_of_package(package: str) -> Iterator[tuple[str, Import]]:
    for path in sorted((HOME / package).rglob("*.py")):
        for found in imports_of(path.read_text(encoding="utf-8")):
            yield path.relative_to(HOME).as_posix(), found


def test_every_form_of_import_is_seen():
    source = (
        "import jax.numpy as jnp, os\n"
        "from optics import planar\n"
        "from . import _beam\n"
        "def late():\n"
        "    import cv2\n"
        "    importlib.import_module('mitsuba')\n"
        "if TYPE_CHECKING:\n"
        "    import scenes\n"
        "else:\n"
        "    import calibration\n"
    )
    assert list(imports_of(source)) == [
        ("jax.numpy", 1, False, ()),
        ("os", 1, False, ()),
        ("optics", 2, False, ("planar",)),
        ("cv2", 5, True, ()),
        ("mitsuba", 6, True, ()),
        ("calibration", 10, False, ()),
    ]


@pytest.mark.parametrize("package", PACKAGES)
def test_a_package_imports_only_what_the_table_allows(package):
    broken = []
    for path, (module, line, _, _) in imports_of_package(package):
        top = module.partition(".")[0]
        ours_forbidden = top in PACKAGES and top not in MAY_IMPORT_OF_OURS[package] | {package}
        theirs_forbidden = package not in MAY_BE_IMPORTED_BY.get(top, {package})
        if ours_forbidden or theirs_forbidden:
            broken.append(f"{path}:{line} imports {module}")
    assert not broken


def test_optics_is_imported_late_and_only_where_a_spot_becomes_a_distance():
    late = [
        (path, imported)
        for package in ("formats", "estimator")
        for path, imported in imports_of_package(package)
        # The mode pixels needs optics from its first line on, so it is imported late as a whole.
        if not path.startswith("estimator/pixels/")
        and imported.module.startswith(("optics", "estimator.pixels"))
    ]
    assert all(imported.late for _, imported in late)
    of_optics = {path for path, imported in late if imported.module.startswith("optics")}
    assert of_optics == LATE_USERS_OF_OPTICS


def test_scenes_take_progress_and_recordings_from_the_estimator_and_nothing_else():
    taken = {
        (module, name)
        for _, (module, _, _, names) in imports_of_package("scenes")
        if module.partition(".")[0] == "estimator"
        for name in names
    }
    assert taken == {
        ("estimator.run.progress_bar", "progress"),
        ("estimator.run.progress_bar", "say"),
        ("estimator.viewer", "check_recording_path"),
        ("estimator.viewer", "record_stack"),
    }


def modules_after(*steps: str) -> list[set[str]]:
    """The modules that a new process has loaded after each of these statements."""
    code = "import sys\n" + "".join(f"{step}\nprint('LOADED', *sys.modules)\n" for step in steps)
    child = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False, cwd=HOME
    )
    loaded = [line for line in child.stdout.splitlines() if line.startswith("LOADED")]
    assert len(loaded) == len(steps), child.stderr
    return [set(line.split()) for line in loaded]


_OF_THE_COMMAND_LINE = {"jax", "mitsuba", "cv2", "numpy", "matplotlib", "pydantic"}
_OF_PHYSICS = {"jax", "mitsuba", "drjit", "optics", "skimage"}


@pytest.mark.parametrize(
    "unwanted",
    [
        {
            "eyespot": _OF_THE_COMMAND_LINE | {"cyclopts"},
            "eyespot.command_line": _OF_THE_COMMAND_LINE,
            "formats": _OF_PHYSICS,
            "estimator": _OF_PHYSICS,
        },
        {
            "optics.models": {"jax", "mitsuba", "drjit", "cv2"},
            "optics": {"jax", "mitsuba", "drjit", "cv2"},
            "scenes": {"mitsuba", "drjit"},
            "calibration": {"mitsuba", "drjit"},
        },
    ],
    ids=lambda unwanted: "-".join(unwanted),
)
def test_an_import_leaves_heavy_libraries_alone(unwanted):
    loaded = modules_after(*(f"import {module}" for module in unwanted))
    for (module, names), found in zip(unwanted.items(), loaded, strict=True):
        assert not names & found, module


HEAVY = {"jax", "mitsuba", "drjit", "cv2", "matplotlib", "distributed"}
RUN = """
import eyespot
def run(*words):
    sys.argv = ["eyespot", *words]
    try: eyespot.main()
    except SystemExit: pass
"""


def test_a_command_loads_only_what_it_uses(tmp_path):
    folder, new = tmp_path / "folder", tmp_path / "new"
    folder.mkdir()
    commands = {
        ("version",): set(),
        ("scene", "init", f"{new}"): set(),
        ("scene", "schema"): set(),
        ("dataset", "verify", f"{folder}"): {"cv2"},
        ("export", f"{folder}", "--to", "hdf5", "--out", f"{new}"): {"cv2"},
        ("track", f"{folder}", "--out", f"{new}.csv"): {"cv2"},
    }
    _, *loaded = modules_after(RUN, *(f"run(*{words})" for words in commands))
    for (words, allowed), found in zip(commands.items(), loaded, strict=True):
        assert HEAVY & found <= allowed, words


def test_no_help_loads_a_heavy_library():
    """But that of a study, whose command stands in the file of what it computes."""
    code = (
        "import importlib, eyespot.command_line\n"
        "groups = eyespot.command_line.COMMANDS.values()\n"
        "for command in [path for group in groups for path in group]:\n"
        "    if not command.startswith('benchmarks.studies.'):\n"
        "        importlib.import_module(command.partition(':')[0])\n"
    )
    (loaded,) = modules_after(code)
    assert not HEAVY & loaded


def test_what_a_user_can_correct_is_an_input_error():
    """`raise ValueError` would be reported as a bug: only an InputError is bad input."""
    raised = [
        f"{path}:{node.lineno}"
        for package in PACKAGES
        for path in sorted((HOME / package).rglob("*.py"))
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.Raise)
        and isinstance(node.exc, ast.Call)
        and isinstance(node.exc.func, ast.Name)
        and node.exc.func.id == "ValueError"
    ]
    assert raised == []
