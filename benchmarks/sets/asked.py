"""What a spec asked for against what its stacks have: of each parameter, and of each pair."""

import itertools
from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd
from pydantic import TypeAdapter
from scipy import stats

from eyespot.benchmarks.sets.read import LabelledSet
from eyespot.benchmarks.sets.spec import Choice, Distribution, LogUniform, Uniform

_SPLITS = ("train", "validation", "test")
"""Splits that have the distributions of [vary]; the others change them."""


def asked_and_drawn(labelled: LabelledSet) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Compare the common splits of a set with [vary] of its spec; empty tables if nothing varies.

    Returns:
        One row a parameter: name, asked, drawn, and the largest difference of the two cumulative
        distributions; and one row a pair of parameters: the cell of halves (of an interval) and
        values (of a choice) that lacks most stacks, and the shares asked and drawn.
    """
    asked = labelled.description["spec"].get("vary", {})
    vary = TypeAdapter(dict[str, Distribution]).validate_python(asked)
    stacks = [s.parameters for s in labelled.stacks if s.split in _SPLITS and s.pair is None]
    found = {key: [own[key] for own in stacks] for key in vary} if stacks else {}
    parameters = [(key, *_parameter(vary[key], values)) for key, values in found.items()]
    cells = {key: _cells(vary[key], values) for key, values in found.items()}
    pairs = [
        (first, second, *_emptiest(cells[first], cells[second]))
        for first, second in itertools.combinations(cells, 2)
    ]
    return (
        pd.DataFrame(parameters, columns=["parameter", "asked", "drawn", "difference"]),
        pd.DataFrame(pairs, columns=["first", "second", "cell", "asked", "drawn"]),
    )


def _law(interval: Uniform | LogUniform) -> Any:
    """The distribution of an interval, as SciPy has it."""
    if isinstance(interval, LogUniform):
        return stats.loguniform(*interval.log_uniform)
    low, high = interval.uniform
    return stats.uniform(low, high - low)


def _parameter(change: Distribution, values: Sequence[Any]) -> tuple[str, str, float]:
    """What was asked, what was drawn, and the largest difference of their distributions."""
    if isinstance(change, Choice):
        counts = [sum(value == one for value in values) for one in change.choice]
        drawn = ", ".join(f"{one}: {n}" for one, n in zip(change.choice, counts, strict=True))
        share = np.array(counts) / len(values)
        return f"one of {len(counts)}", drawn, float(np.abs(share - 1 / len(counts)).max())
    (kind, (low, high)) = next(iter(change.model_dump().items()))
    distance = stats.kstest(values, _law(change).cdf).statistic
    named = f"{kind.replace('_', '-')}, {low:g} to {high:g}"
    return named, f"{min(values):.4g} to {max(values):.4g}", float(distance)


def _cells(change: Distribution, values: Sequence[Any]) -> tuple[list[str], np.ndarray]:
    """Names of a parameter's equally likely cells, and each stack's cell."""
    if isinstance(change, Choice):
        places = [change.choice.index(value) for value in values]
        return [str(one) for one in change.choice], np.array(places)
    (low, high) = next(iter(change.model_dump().values()))
    middle = _law(change).median()
    upper = np.array(values) >= middle
    return [f"{low:g} to {middle:.4g}", f"{middle:.4g} to {high:g}"], upper.astype(int)


def _emptiest(
    first: tuple[list[str], np.ndarray], second: tuple[list[str], np.ndarray]
) -> tuple[str, float, float]:
    """The pair of cells with the fewest stacks, and the shares asked and drawn."""
    (rows, i), (columns, j) = first, second
    counts, *_ = np.histogram2d(i, j, [np.arange(len(names) + 1) for names in (rows, columns)])
    row, column = np.unravel_index(np.argmin(counts), counts.shape)
    name = f"{rows[row]} with {columns[column]}"
    return name, 1 / counts.size, float(counts[row, column] / counts.sum())
