"""Operations on three-vectors by components.

XLA on a CPU vectorises over the batch only if no operation runs along an axis of length three. For
the contour of a spot this reduces the time from 10 to 1.2 us.
"""

from __future__ import annotations

import jax.numpy as jnp
from jaxtyping import Array, Float


def components(vectors: Float[Array, "*batch 3"]) -> tuple[Float[Array, "*batch"], ...]:
    """The x, y and z of vectors."""
    return tuple(vectors[..., k] for k in range(3))


def dot(a: Float[Array, "*batch 3"], b: Float[Array, "*batch 3"]) -> Float[Array, "*batch"]:
    """Scalar product."""
    (ax, ay, az), (bx, by, bz) = components(a), components(b)
    return ax * bx + ay * by + az * bz


def ray_point(
    origin: Float[Array, "*batch 3"],
    direction: Float[Array, "*batch 3"],
    distance: Float[Array, "*batch"],
) -> Float[Array, "*batch 3"]:
    """Point of a ray at a distance from its origin."""
    starts, steps = components(origin), components(direction)
    return jnp.stack([o + distance * d for o, d in zip(starts, steps, strict=True)], axis=-1)
