"""Mean, root mean square and largest size of errors; NaN stands for a missing one and is left out.

All are NaN if no error is there.
"""

from __future__ import annotations

import math
from collections.abc import Iterable


def mean(errors: Iterable[float]) -> float:
    """Their mean."""
    there = _there(errors)
    return sum(there) / len(there) if there else math.nan


def rms(errors: Iterable[float]) -> float:
    """Their root mean square."""
    return math.sqrt(mean(e * e for e in errors))


def largest(errors: Iterable[float]) -> float:
    """The largest absolute value."""
    return max(map(abs, _there(errors)), default=math.nan)


def _there(errors: Iterable[float]) -> list[float]:
    return [float(e) for e in errors if not math.isnan(e)]
