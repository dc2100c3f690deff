"""A compiled function of many items in batches of equal size, on all cores."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import jax
import numpy as np
from jaxtyping import PyTree


def in_batches(function: Callable[[Any], Any], items: PyTree, *, size: int) -> PyTree:
    """Results of a function that treats arrays with a leading axis item by item.

    All batches have one shape, whatever the number of items, so that it is compiled once. One batch
    is too small for several cores, so each core takes a batch of its own.

    Args:
        function: of a batch; compiled.
        items: arrays with a leading axis of one length.
        size: items per batch; the last batch is filled up with its last item.
    """
    items = jax.tree.map(np.asarray, items)
    count = len(jax.tree.leaves(items)[0])

    def batch(first: int) -> Any:
        rows = np.minimum(np.arange(first, first + size), count - 1)
        return jax.tree.map(np.asarray, function(jax.tree.map(lambda leaf: leaf[rows], items)))

    first, *rest = range(0, count, size)
    with ThreadPoolExecutor() as pool:
        # The first batch runs alone, so that only one thread compiles.
        done = [batch(first), *pool.map(batch, rest)]
    return jax.tree.map(lambda *leaves: np.concatenate(leaves)[:count], *done)
