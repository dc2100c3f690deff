"""The faces of the packages are true, and no module or folder imports itself by way of others."""

from __future__ import annotations

import ast
import subprocess
import sys
from collections import defaultdict
from collections.abc import Iterator
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

HOME = Path(__file__).resolve().parents[2]
PACKAGES = ("formats", "optics", "scenes", "estimator", "calibration", "benchmarks")


def module_of(path: Path) -> str:
    parts = path.relative_to(HOME).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


MODULES = {
    module_of(path): path for package in PACKAGES for path in sorted((HOME / package).rglob("*.py"))
}
ROOMS = sorted(module for module, path in MODULES.items() if path.name == "__init__.py")


def room_of(module: str) -> str:
    """The folder of a module; a file that lies directly in a package is a room of its own."""
    parent = module.rpartition(".")[0]
    return module if module in ROOMS or parent in PACKAGES else parent


def imported_names(path: Path) -> Iterator[tuple[str, str, int]]:
    """Module, name and line of each import of ours, late ones and those for types included."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] in PACKAGES:
            assert node.module and not node.level
            yield from ((node.module, alias.name, node.lineno) for alias in node.names)
        elif isinstance(node, ast.Import):
            for alias in node.names:
                if alias.name.split(".")[0] in PACKAGES:
                    yield alias.name, "", node.lineno


def face(room: str) -> dict[str, str]:
    """The public names of a room, each with the module or room that it comes from."""
    stub = MODULES[room].with_suffix(".pyi")
    found = {}
    for node in ast.parse(stub.read_text(encoding="utf-8")).body if stub.exists() else ():
        assert isinstance(node, ast.ImportFrom), f"{stub}: a face only imports"
        for alias in node.names:
            found[alias.name] = f"{room}.{node.module or alias.name}"
    return found


FACES = {room: face(room) for room in ROOMS}


def home_of(module: str, name: str) -> str:
    """The module in which an imported name is defined, looked up through the faces."""
    while name in FACES.get(module, {}):
        module = FACES[module][name]
    return f"{module}.{name}" if f"{module}.{name}" in MODULES else module


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


@pytest.mark.parametrize("package", PACKAGES)
def test_no_module_imports_itself_by_way_of_others(package):
    graph = defaultdict(set)
    for module, path in MODULES.items():
        if module.split(".")[0] == package:
            homes = {home_of(source, name) for source, name, _ in imported_names(path)}
            graph[module] = {home for home in homes if home.split(".")[0] == package} - {module}
    assert not _circle(graph)


@pytest.mark.parametrize("package", PACKAGES)
def test_no_room_imports_itself_by_way_of_others(package):
    graph: dict[str, set[str]] = defaultdict(set)
    for module, path in MODULES.items():
        if module.split(".")[0] == package and module not in ROOMS:
            for source, name, _ in imported_names(path):
                other = room_of(home_of(source, name))
                if other.split(".")[0] == package and other != room_of(module):
                    graph[room_of(module)].add(other)
    assert not _circle(graph)


def _circle(graph: dict[str, set[str]]) -> list[str]:
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        return list(error.args[1])
    return []


def test_every_import_is_declared_and_every_dependency_is_used():
    found = subprocess.run(
        [sys.executable, "-m", "deptry", "."], cwd=HOME, capture_output=True, text=True, check=False
    )
    assert found.returncode == 0, found.stderr


def test_a_class_name_has_one_meaning():
    """In all packages; a leading underscore makes no other name."""
    homes = defaultdict(list)
    for module, path in MODULES.items():
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ClassDef):
                homes[node.name.lstrip("_")].append(module)
    assert {name: where for name, where in homes.items() if len(where) > 1} == {}
