"""Benchmarks of speed and accuracy in the form of asv: classes with parameters, no tables.

`python -m benchmarks.bench NAME` runs one of them; `make bench` runs those that take minutes. What
`eyespot score` and the studies measure is not measured here again.

__main__  The command line: runs classes and prints their table
detector  Time of a frame in sub-pixel and literal mode
fits      Accuracy and time of fits to spots, to pixels and through glass
load      Long runs: `eyespot track`, a `Reader` at a camera's pace, the books of a large set
pixels    The mode pixels on drawn stacks: errors, stated errors, adverse conditions, memory
viewing   Time of lines of sight, exact spots and frames through a contact lens into an eye
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

T = TypeVar("T", bound=type)


def tracks(**numbers: Callable[..., float]) -> Callable[[T], T]:
    """Give a benchmark a method `track_NAME` for each function of itself and a row's parameters."""

    def with_methods(kind: T) -> T:
        for name, number in numbers.items():
            setattr(kind, f"track_{name}", number)
        return kind

    return with_methods
