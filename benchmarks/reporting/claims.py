"""A claim: a measured value, its bounds, and a sentence."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from benchmarks.reporting.typeset import filled


@dataclass(frozen=True, kw_only=True)
class Claim:
    """One result of a run.

    Attributes:
        name: subject of the claim, the same in every run.
        sentence: template for `value` and `numbers`: "The largest error is {value:.2f} mm."
        value: measured value; if there are several, each must lie within the bounds.
        low: least value for which the claim holds.
        high: greatest value for which the claim holds.
        numbers: further values of the sentence by name: numbers, texts, rows ("{row.field:.2f}").
    """

    name: str
    sentence: str
    value: float | tuple[float, ...] = math.nan
    low: float = -math.inf
    high: float = math.inf
    numbers: Mapping[str, Any] = field(default_factory=dict)

    @property
    def holds(self) -> bool | None:
        """Whether all values lie within the bounds; None for a claim without bounds."""
        if math.isinf(self.low) and math.isinf(self.high):
            return None
        values = self.value if isinstance(self.value, tuple) else (self.value,)
        return all(self.low <= value <= self.high for value in values)

    @property
    def text(self) -> str:
        """The sentence with its numbers."""
        bounds = {"value": self.value, "low": self.low, "high": self.high}
        return filled(self.sentence, {**bounds, **self.numbers})

    @property
    def row(self) -> dict[str, Any]:
        """The claim for summary.json."""
        return {
            "name": self.name,
            "text": self.text,
            "value": self.value,
            "low": self.low,
            "high": self.high,
            "holds": self.holds,
            "numbers": {
                name: item._asdict() if hasattr(item, "_asdict") else item
                for name, item in self.numbers.items()
            },
        }
