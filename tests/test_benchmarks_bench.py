"""The command `python -m benchmarks.bench` against the modules that it runs."""

import ast
import subprocess
import sys
from pathlib import Path

from benchmarks.bench.__main__ import BY_NAME_ONLY, MAKE_BENCH, SEEDED

BENCH = Path(__file__).resolve().parents[1] / "benchmarks" / "bench"


def run_parameters(path: Path) -> list[str] | None:
    """Names of the keyword-only parameters of a module's function `run`; None without one."""
    for node in ast.parse(path.read_text(encoding="utf-8")).body:
        if isinstance(node, ast.FunctionDef) and node.name == "run":
            assert not node.args.args
            return [argument.arg for argument in node.args.kwonlyargs]
    return None


def test_the_command_knows_every_bench_and_all_are_called_alike():
    found = {
        path.relative_to(BENCH).with_suffix("").as_posix().replace("/", "."): parameters
        for path in BENCH.rglob("*.py")
        if (parameters := run_parameters(path)) is not None
    }
    assert found == {
        name: ["full", "seed"] if name in SEEDED else ["full"]
        for name in (*MAKE_BENCH, *BY_NAME_ONLY)
    }


def test_an_unknown_bench_is_refused():
    command = [sys.executable, "-m", "benchmarks.bench", "cone_fti"]
    done = subprocess.run(
        command, cwd=BENCH.parents[1], capture_output=True, text=True, check=False
    )
    assert done.returncode == 2
    assert "no such bench: cone_fti" in done.stderr
