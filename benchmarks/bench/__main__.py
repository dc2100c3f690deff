"""Runs benchmarks: `python -m eyespot.benchmarks.bench [NAME ...] [--full]`.

A benchmark is a public function of one of the `FILES` that takes `full` and returns a table. The
first sentence of its docstring is the table's title.
"""

import inspect
import os
from collections.abc import Callable
from importlib import import_module
from typing import Annotated

import cyclopts
import pandas as pd
from cyclopts import Parameter

import eyespot as eyespot  # so that what JAX compiles is kept

FILES = ("fits", "load", "pixels", "promises")
LONG = {"branches", "coverage", "memory", "books"}
"""What `make bench` leaves out, because it takes long."""


def benchmarks() -> dict[str, Callable[..., pd.DataFrame]]:
    """All benchmarks by name, "fits.cone_withdrawals"."""
    return {
        f"{file}.{name}": bench
        for file in FILES
        for name, bench in vars(import_module(f"eyespot.benchmarks.bench.{file}")).items()
        if inspect.isfunction(bench) and "full" in inspect.signature(bench).parameters
    }


def main(*names: str, full: Annotated[bool, Parameter(negative=())] = False) -> None:
    """Measure speed and accuracy, and print tables.

    Args:
        names: Benchmarks or files of them (default: those that `make bench` runs).
        full: Use the numbers of stacks and frames that the documentation quotes.
    """
    known = benchmarks()
    wanted = [n for n in known if not names or n in names or n.split(".")[0] in names]
    wanted = [n for n in wanted if names or n.split(".")[1] not in LONG]
    if unknown := [n for n in names if n not in known and n not in FILES]:
        raise SystemExit(f"no benchmark {unknown[0]}; there are {', '.join((*FILES, *known))}")
    for name in wanted:
        print(f"\n== {name}: {(known[name].__doc__ or '').splitlines()[0]}", flush=True)
        found = known[name](full=full)
        print(found.T.to_string(line_width=120, float_format=lambda x: f"{x:.5g}"))
        print(f"load {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores")


if __name__ == "__main__":
    cyclopts.run(main)
