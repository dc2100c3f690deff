"""Distributions of a scene key; each maps a quantile in [0, 1) to a value."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, ConfigDict, Discriminator, Field, Tag

from optics import InputError

_LARGEST = 1e12
"""Of either end of an interval, so that widths and quotients of the two are finite."""


class _Distribution(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


def _ordered(interval: tuple[float, float]) -> tuple[float, float]:
    low, high = interval
    if not -_LARGEST <= low < high <= _LARGEST:
        raise InputError(
            f"an interval must be [low, high], within {_LARGEST:g}, with low < high; got "
            f"[{low:g}, {high:g}]. For a single value write key = value."
        )
    return interval


def _positive(interval: tuple[float, float]) -> tuple[float, float]:
    if interval[0] < 1 / _LARGEST:
        raise InputError(
            f"a log-uniform interval must lie above 0; got [{interval[0]:g}, {interval[1]:g}]. "
            "Raise its lower end, or use uniform."
        )
    return interval


def _finite(values: tuple[Any, ...]) -> tuple[Any, ...]:
    if any(isinstance(value, float) and not math.isfinite(value) for value in values):
        raise InputError(
            "a choice must have finite values, because it becomes a label in JSON. Use a large "
            "number instead of inf."
        )
    return values


_Interval = Annotated[tuple[float, float], AfterValidator(_ordered)]


class Uniform(_Distribution):
    """Uniform distribution on an interval."""

    uniform: _Interval

    def value(self, quantile: float) -> float:
        """The value at this quantile."""
        low, high = self.uniform
        return low + quantile * (high - low)


class LogUniform(_Distribution):
    """Log-uniform distribution: the logarithm is uniform."""

    log_uniform: Annotated[_Interval, AfterValidator(_positive)]

    def value(self, quantile: float) -> float:
        """The value at this quantile."""
        low, high = self.log_uniform
        return low * (high / low) ** quantile


class Choice(_Distribution):
    """One of several values, all equally likely."""

    choice: Annotated[tuple[Any, ...], AfterValidator(_finite)] = Field(
        min_length=2, max_length=4096
    )

    def value(self, quantile: float) -> Any:
        """The value at this quantile of the list."""
        return self.choice[int(quantile * len(self.choice))]


Distribution = Uniform | LogUniform | Choice
KINDS = ("uniform", "log_uniform", "choice")


def _kind(change: Any) -> str:
    """The kind of distribution of a change, or "value"."""
    if isinstance(change, Distribution):
        return next(iter(type(change).model_fields))
    return next((kind for kind in KINDS if isinstance(change, Mapping) and kind in change), "value")


Change = Annotated[
    Annotated[Uniform, Tag("uniform")]
    | Annotated[LogUniform, Tag("log_uniform")]
    | Annotated[Choice, Tag("choice")]
    | Annotated[Any, Tag("value")],
    Discriminator(_kind),
]
"""Change of a scene key in a spec: a distribution or a fixed value."""


def by_dotted_name(table: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """The values and distributions of a nested table, by dotted scene key."""
    found: dict[str, Any] = {}
    for name, value in table.items():
        key = f"{prefix}{name}"
        if isinstance(value, Mapping) and _kind(value) == "value":
            found |= by_dotted_name(value, f"{key}.")
        else:
            found[key] = value
    return found
