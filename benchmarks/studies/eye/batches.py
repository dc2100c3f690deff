"""A function of many items in batches of equal size."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import PyTree


def in_batches(one: Callable[[Any], Any], items: PyTree, *, size: int) -> PyTree:
    """`jax.vmap` of a function in batches, one after the other, which bounds the memory.

    The last batch is filled up with its last item. `jax.lax.map` would compile the function a
    second time for the batch that remains.

    Args:
        one: function of one item.
        items: arrays with a leading axis of one length.
        size: items per batch.
    """
    arrays, constant = eqx.partition(items, eqx.is_array)
    count = len(jax.tree.leaves(arrays)[0])

    def batches(leaf: Any) -> Any:
        missing = -count % size
        full = jnp.concatenate([leaf, jnp.repeat(leaf[-1:], missing, axis=0)])
        return full.reshape(-1, size, *leaf.shape[1:])

    def in_order(leaf: Any) -> Any:
        return leaf.reshape(-1, *leaf.shape[2:])[:count]

    each = jax.vmap(lambda item: one(eqx.combine(item, constant)))
    return jax.tree.map(in_order, jax.lax.map(each, jax.tree.map(batches, arrays)))
