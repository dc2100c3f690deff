"""NumPy or JAX, chosen by a function's arguments; does not import JAX."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from jaxtyping import ArrayLike


def array_namespace(*values: ArrayLike) -> Any:
    """`jax.numpy` if one of the values is a JAX array (traced or not), otherwise `numpy`."""
    spaces = (v.__array_namespace__() for v in values if hasattr(v, "__array_namespace__"))
    return next((space for space in spaces if space is not np), np)
