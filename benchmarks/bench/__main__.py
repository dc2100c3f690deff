"""Runs benchmarks: `python -m benchmarks.bench [NAME ...] [--full]`.

A benchmark is a class in the form of airspeed velocity: `params` and `param_names`, `setup`,
perhaps `setup_cache`, and methods `time_…` (a call is timed) and `track_…` (the result is the
number, its unit the end of the name). A row of the table is a combination of parameters, a column a
method.
"""

from __future__ import annotations

import inspect
import itertools
import os
import time
from collections.abc import Callable
from functools import partial
from importlib import import_module
from typing import Annotated, Any

import cyclopts
import numpy as np
import pandas as pd
from cyclopts import Parameter

FILES = ("fits", "load", "pixels", "speed")
LONG = {"Branches", "Coverage", "AdverseSet", "Memory", "Books"}
"""What `make bench` leaves out, because it takes long."""


def benchmarks() -> dict[str, type]:
    """All benchmarks by name, "fits.ConeWithdrawals"."""
    found = {}
    for file in FILES:
        module = import_module(f"benchmarks.bench.{file}")
        for name, kind in vars(module).items():
            own = inspect.isclass(kind) and kind.__module__ == module.__name__
            if own and not name.startswith("_") and _methods(kind):
                found[f"{file}.{name}"] = kind
    return found


def table(kind: type[Any]) -> pd.DataFrame:
    """Run a benchmark: its parameters and what its methods found, a row for each combination."""
    cached = [kind().setup_cache()] if hasattr(kind, "setup_cache") else []
    names = getattr(kind, "param_names", [])
    rows = []
    for values in itertools.product(*getattr(kind, "params", [])):
        one, row = kind(), dict(zip(names, values, strict=True))
        if hasattr(one, "setup"):
            one.setup(*cached, *values)
        for name in _methods(kind):
            what, _, about = name.partition("_")
            call = getattr(one, name)
            row |= _MEASURES[what](about, partial(call, *cached, *values))
        rows.append(row)
    return pd.DataFrame(rows)


def _methods(kind: type) -> list[str]:
    """The methods of a benchmark in the order in which they are written, those of bases first."""
    written = dict.fromkeys(name for base in reversed(kind.__mro__) for name in vars(base))
    return [name for name in written if name.partition("_")[0] in _MEASURES and "_" in name]


def _timed(about: str, call: Callable[[], object]) -> dict[str, float]:
    """Median wall and processor time after one call that compiles."""
    call()
    wall, worked = [], []
    for _ in range(20):
        began = time.perf_counter(), time.process_time()
        call()
        wall.append(time.perf_counter() - began[0])
        worked.append(time.process_time() - began[1])
        if sum(wall) > 10:
            break
    return {f"{about}_ms": 1e3 * np.median(wall), f"{about}_cpu_ms": 1e3 * np.median(worked)}


_MEASURES: dict[str, Callable[[str, Callable[[], Any]], dict[str, Any]]] = {
    "time": _timed,
    "track": lambda about, call: {about: call()},
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
        known[name].full = full  # type: ignore[attr-defined]
        print(f"\n== {name}: {(known[name].__doc__ or '').splitlines()[0]}", flush=True)
        found = table(known[name])
        if names_of := list(getattr(known[name], "param_names", ())):
            found = found.set_index(names_of)
        print(found.T.to_string(line_width=120, float_format=lambda x: f"{x:.5g}"))
        print(f"load {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores")


if __name__ == "__main__":
    cyclopts.run(main)
