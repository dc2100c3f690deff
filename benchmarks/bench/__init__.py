"""Benchmarks of speed and accuracy in the form of asv: classes with parameters, no tables.

`python -m benchmarks.bench NAME` runs one of them; `make bench` runs those that take minutes. What
`eyespot score` and the studies measure is not measured here again.
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
