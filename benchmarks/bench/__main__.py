"""Runs benchmarks: `python -m benchmarks.bench [NAME ...] [--full]`."""

from __future__ import annotations

import importlib
import sys
from typing import Annotated

import cyclopts
from cyclopts import Parameter
from cyclopts.types import NonNegativeInt

MAKE_BENCH = (
    "estimator.speed",
    "estimator.spotless",
    "estimator.stated_errors",
    "cone_fit",
    "image_fit",
    "frame_pose",
    "pixel_pose",
    "pixel_adverse",
    "viewing_speed",
    "load",
)
"""What `make bench` runs. Each module has a function `run(*, full: bool)` that prints tables,
some with a seed, too."""

BY_NAME_ONLY = (
    "lens_fit",
    "photon_fit",
    "estimator.tuning",
    "set_size",
    "pixel_branches",
    "pixel_memory",
)
"""Benches that take long."""

SEEDED = ("estimator.stated_errors",)
"""Benches whose frames follow from a seed."""

_SEED = 2026


def main(
    *names: Annotated[str, Parameter(choices=(*MAKE_BENCH, *BY_NAME_ONLY))],
    full: bool = False,
    seed: NonNegativeInt | None = None,
) -> None:
    """Measure speed and accuracy, each compared with alternatives, and print tables.

    Args:
        names: Benches to run (default: those of `make bench`, which are the first ones).
        full: Use more or larger frames in estimator.speed, estimator.spotless,
            estimator.stated_errors, image_fit, pixel_pose, pixel_adverse, pixel_branches,
            pixel_memory, load.
        seed: Random seed of estimator.stated_errors (default: 2026).
    """
    if seed is not None and not {*(names or MAKE_BENCH)} & {*SEEDED}:
        print(f"--seed belongs to {', '.join(SEEDED)}.", file=sys.stderr)
        sys.exit(2)
    for name in names or MAKE_BENCH:
        print(f"\n== {name}", flush=True)
        module = importlib.import_module(f"benchmarks.bench.{name}")
        if name in SEEDED:
            module.run(full=full, seed=_SEED if seed is None else seed)
        else:
            module.run(full=full)


if __name__ == "__main__":
    cyclopts.run(main)
