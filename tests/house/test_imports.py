"""Who may import whom, what an import must not load, and what the packages' faces offer."""

import ast
import functools
import subprocess
import sys
from collections import Counter, defaultdict
from graphlib import TopologicalSorter
from pathlib import Path
from typing import NamedTuple

import pytest

from tests.support.command_line import run_python

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
    # What `make setup-rig` leaves out, beside the renderer and optax.
    "dask": {"benchmarks"},
    "distributed": {"benchmarks"},
    "skimage": {"scenes", "benchmarks"},
}

# Where a spot becomes a distance, and the microscope that the others see the eye through.
LATE_USERS_OF_OPTICS = {
    "eyespot.estimator.distance.budget",
    "eyespot.estimator.distance.cone_range",
    "eyespot.estimator.distance.lens_range",
    "eyespot.estimator.distance.ranger",
    "eyespot.formats.microscope",
}


class Import(NamedTuple):
    """A module that is imported, its line, whether in a function, and the names taken from it."""

    module: str
    line: int
    late: bool = False
    names: tuple[str, ...] = ()


def name_of(node):
    """`c` of a name `c` and of an attribute `a.b.c`."""
    return getattr(node, "attr", getattr(node, "id", ""))


def imports_of(tree):
    """Every absolute import, `importlib.import_module("...")` among them.

    What stands under `if TYPE_CHECKING:` is read by type checkers and imported by nobody.
    """

    def visit(node, late):
        children = ast.iter_child_nodes(node)
        if isinstance(node, ast.If) and name_of(node.test) == "TYPE_CHECKING":
            children = iter(node.orelse)
        elif isinstance(node, ast.Import):
            yield from (Import(alias.name, node.lineno, late) for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            names = tuple(alias.name for alias in node.names)
            if node.module == "eyespot":
                yield from (Import(f"eyespot.{name}", node.lineno, late) for name in names)
            else:
                yield Import(node.module or "", node.lineno, late, names)
        elif isinstance(node, ast.Call) and node.args and isinstance(node.args[0], ast.Constant):
            if name_of(node.func) in ("import_module", "__import__"):
                yield Import(str(node.args[0].value), node.lineno, late)
        late = late or isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda)
        for child in children:
            yield from visit(child, late)

    return list(visit(tree, late=False))


def module_of(path):
    parts = "eyespot", *path.relative_to(HOME).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


MODULES = {
    module_of(path): path for package in PACKAGES for path in sorted((HOME / package).rglob("*.py"))
}


@functools.cache
def trees():
    return {name: ast.parse(path.read_text(encoding="utf-8")) for name, path in MODULES.items()}


@functools.cache
def imports():
    return {name: imports_of(tree) for name, tree in trees().items()}


ROOMS = {module for module, path in MODULES.items() if path.name == "__init__.py"}


def top(module):
    """One of our packages, or another distribution's."""
    return module.removeprefix("eyespot.").partition(".")[0]


def room_of(module):
    """The folder of a module; a file that lies directly in a package is a room of its own."""
    parent = module.rpartition(".")[0]
    return module if module in ROOMS or parent.count(".") < 2 else parent


def face(room):
    """The public names of a room, each with the module or room that it comes from."""
    stub = MODULES[room].with_suffix(".pyi")
    found = {}
    for node in ast.parse(stub.read_text(encoding="utf-8")).body if stub.exists() else ():
        assert isinstance(node, ast.ImportFrom), f"{stub}: a face only imports"
        for alias in node.names:
            found[alias.name] = f"{room}.{node.module or alias.name}"
    return found


FACES = {room: face(room) for room in ROOMS}


def home_of(module, name):
    """The module in which an imported name is defined, looked up through the faces."""
    while name in FACES.get(module, {}):
        module = FACES[module][name]
    return f"{module}.{name}" if f"{module}.{name}" in MODULES else module


def homes_imported_by(module):
    """Modules of its own package that a module imports, late ones included."""
    homes = {
        home_of(found.module, name)
        for found in imports()[module]
        if top(found.module) == top(module)
        for name in found.names or ("",)
    }
    return homes - {module}


def test_every_form_of_import_is_seen():
    source = (
        "import jax.numpy as jnp, os\n"
        "from eyespot.optics import planar\n"
        "from . import _beam\n"
        "def late():\n"
        "    import cv2\n"
        "    importlib.import_module('mitsuba')\n"
        "if TYPE_CHECKING:\n"
        "    import eyespot.scenes\n"
        "else:\n"
        "    from eyespot import calibration\n"
    )
    assert imports_of(ast.parse(source)) == [
        ("jax.numpy", 1, False, ()),
        ("os", 1, False, ()),
        ("eyespot.optics", 2, False, ("planar",)),
        ("cv2", 5, True, ()),
        ("mitsuba", 6, True, ()),
        ("eyespot.calibration", 10, False, ()),
    ]


def allowed(package, imported):
    if imported in PACKAGES:
        return imported == package or imported in MAY_IMPORT_OF_OURS[package]
    return package in MAY_BE_IMPORTED_BY.get(imported, PACKAGES)


def test_our_packages_have_one_name():
    """In code, tests and docs: a bare `optics` would be anybody's."""
    said = subprocess.run(
        [
            "git",
            "grep",
            "-nE",
            rf"^\s*(>>> )?(from|import) ({'|'.join(PACKAGES)})\b"
            # Names of packages as strings, such as those of folders of templates.
            rf"|(templates|files|import_module|PackageLoader)\(.?({'|'.join(PACKAGES)})\b",
            "--",
            ":!CHANGELOG.md",
            ":!*.diff",
        ],
        cwd=HOME,
        capture_output=True,
        text=True,
    )
    assert said.returncode == 1, said.stdout + said.stderr


def test_a_package_imports_only_what_the_table_allows():  # 5 s: 280 files are parsed, once
    assert not [
        f"{module}:{found.line} imports {found.module}"
        for module, found_in_it in imports().items()
        for found in found_in_it
        if not allowed(top(module), top(found.module))
    ]


def test_optics_is_imported_late_and_only_where_a_spot_becomes_a_distance():
    found = {
        module: [
            one
            for one in found_in_it
            if one.module.startswith(("eyespot.optics", "eyespot.estimator.pixels"))
        ]
        for module, found_in_it in imports().items()
        # The mode pixels needs optics from its first line on, so it is imported late as a whole.
        if top(module) in ("formats", "estimator")
        and not module.startswith("eyespot.estimator.pixels")
    }
    assert all(one.late for imports in found.values() for one in imports)
    users = {name for name, imports in found.items() for one in imports if "optics" in one.module}
    assert users == LATE_USERS_OF_OPTICS


def test_scenes_take_progress_and_recordings_from_the_estimator_and_nothing_else():
    taken = {
        f"{found.module}.{name}"
        for module, found_in_it in imports().items()
        for found in found_in_it
        if top(module) == "scenes" and top(found.module) == "estimator"
        for name in found.names
    }
    assert taken == {
        "eyespot.estimator.run.progress_bar.progress",
        "eyespot.estimator.run.progress_bar.say",
        "eyespot.estimator.viewer.check_recording_path",
        "eyespot.estimator.viewer.record_stack",
    }


def test_what_a_face_offers_is_there_and_not_hidden_by_a_module_of_the_same_name():
    broken = []
    for room, names in FACES.items():
        for name, home in names.items():
            if home not in MODULES:
                broken.append(f"{room} offers {name} from {home}, which does not exist")
            elif home != f"{room}.{name}" and f"{room}.{name}" in MODULES:
                broken.append(f"{room}.{name} is a module and a name of the face")
            elif name.startswith("_"):
                broken.append(f"{room} offers {name}, which is private")
    assert not broken, "\n".join(broken)


def test_no_module_and_no_room_imports_itself_by_way_of_others():
    rooms: dict[str, set[str]] = defaultdict(set)
    for module in MODULES.keys() - ROOMS:
        others = {room_of(home) for home in homes_imported_by(module)}
        rooms[room_of(module)] |= others - {room_of(module)}
    for graph in ({module: homes_imported_by(module) for module in MODULES}, rooms):
        TopologicalSorter(graph).prepare()  # raises an error that names the circle


def test_every_import_is_declared_and_every_dependency_is_used():
    found = subprocess.run(
        [sys.executable, "-m", "deptry", "."], cwd=HOME, capture_output=True, text=True, check=False
    )
    assert found.returncode == 0, found.stderr


def test_a_file_has_a_name_of_its_own():
    """A study has its command's name, and its subject may have a file elsewhere."""
    files = [
        file.name
        for package in PACKAGES
        for file in (HOME / package).rglob("*.py")
        if not file.name.startswith("__") and file.parent.name != "studies"
    ]
    assert [name for name, count in Counter(files).items() if count > 1] == []


def test_a_class_name_has_one_meaning():
    """In all packages; a leading underscore makes no other name."""
    homes = defaultdict(list)
    for module, tree in trees().items():
        for node in ast.walk(tree):
            if isinstance(node, ast.ClassDef):
                homes[node.name.lstrip("_")].append(module)
    assert {name: where for name, where in homes.items() if len(where) > 1} == {}


def test_what_a_user_can_correct_is_an_input_error():
    """`raise ValueError` would be reported as a bug: only an InputError is bad input."""
    raised = [
        f"{module}:{node.lineno}"
        for module, tree in trees().items()
        for node in ast.walk(tree)
        if isinstance(node, ast.Raise)
        and isinstance(node.exc, ast.Call)
        and name_of(node.exc.func) == "ValueError"
    ]
    assert raised == []


def modules_after(*steps):
    """The modules that a new process has loaded after each of these statements."""
    code = "import sys\n" + "".join(f"{step}\nprint('LOADED', *sys.modules)\n" for step in steps)
    child = run_python(code, cwd=HOME)
    loaded = [line for line in child.stdout.splitlines() if line.startswith("LOADED")]
    assert len(loaded) == len(steps), child.stderr
    return [set(line.split()) for line in loaded]


_OF_THE_COMMAND_LINE = {"jax", "mitsuba", "cv2", "numpy", "matplotlib", "pydantic"}
_OF_PHYSICS = {"jax", "mitsuba", "drjit", "eyespot.optics", "skimage"}


@pytest.mark.parametrize(
    "unwanted",
    [
        {
            "eyespot": _OF_THE_COMMAND_LINE | {"cyclopts"},
            "eyespot.command_line": _OF_THE_COMMAND_LINE,
            "eyespot.formats": _OF_PHYSICS,
            "eyespot.estimator": _OF_PHYSICS,
        },
        {
            "eyespot.optics.models": {"jax", "mitsuba", "drjit", "cv2"},
            "eyespot.optics": {"jax", "mitsuba", "drjit", "cv2"},
            "eyespot.scenes": {"mitsuba", "drjit"},
            "eyespot.calibration": {"mitsuba", "drjit"},
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
    """Of a command's file only what its signature needs is executed."""
    code = (
        "from eyespot.command_line import groups\n"
        "functions = [group[name].default_command for group in groups.values() for name in group]"
    )
    (loaded,) = modules_after(code)
    assert not (HEAVY | {"scipy", "pandas"}) & loaded
