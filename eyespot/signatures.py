"""Every command by its signature; what it needs for its work is loaded when it is called.

JAX, Mitsuba and pandas take seconds to load, too long to wait for a help text or for the refusal of
a misspelt option. So only those statements of a command's file are executed that its signature
needs. The name of a command here is its path in `eyespot`, such as "scenes.commands.render".
"""

from __future__ import annotations

import ast
import functools
from collections.abc import Callable, Iterator
from importlib import import_module, util
from pathlib import Path
from typing import Any


def __getattr__(path: str) -> Callable[..., Any]:
    """A command that loads its module when it is called."""
    module, _, name = f"eyespot.{path}".rpartition(".")
    if path.startswith("__"):
        raise AttributeError(path)

    @functools.wraps(_signature(module, name))
    def command(*args: Any, **options: Any) -> Any:
        return getattr(import_module(module), name)(*args, **options)

    return command


def _signature(module: str, name: str) -> Any:
    """A function with its docstring and its options; the names in its body are missing."""
    spec = util.find_spec(module)
    assert spec and spec.origin
    statements = ast.parse(Path(spec.origin).read_bytes()).body
    origins = {bound: one for one in statements for bound in _bound(one)}
    if name not in origins:
        raise AttributeError(f"{module} has no {name}")
    needed, found = [origins[name]], set[ast.stmt]()
    while needed:
        statement = needed.pop()
        if statement not in found:
            found.add(statement)
            names = {node.id for node in _executed(statement) if isinstance(node, ast.Name)}
            needed += [origins[used] for used in names & origins.keys()]
    own = ast.Module([one for one in statements if one in found], type_ignores=[])
    namespace: dict[str, Any] = {"__name__": module}
    exec(compile(own, spec.origin, "exec"), namespace)
    return namespace[name]


def _bound(statement: ast.stmt) -> Iterator[str]:
    """The names that a statement defines."""
    if isinstance(statement, ast.FunctionDef | ast.ClassDef):
        yield statement.name
        return
    for node in ast.walk(statement):
        if isinstance(node, ast.alias):
            yield node.asname or node.name.partition(".")[0]
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            yield node.id


def _executed(statement: ast.stmt) -> Iterator[ast.AST]:
    """The parts that run when a statement does: of a function, no body."""
    if not isinstance(statement, ast.FunctionDef):
        yield from ast.walk(statement)
        return
    # Of a command's parameters the command line sets those by place only and by keyword only; a
    # decorator sets the others, whose types may be slow to load.
    for parameter in statement.args.args:
        parameter.annotation = None
    statement.returns = None
    for part in (statement.args, *statement.decorator_list):
        yield from ast.walk(part)
