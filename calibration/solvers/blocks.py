r"""Gauss-Newton for a few shared parameters and blocks of data with parameters of their own.

The residuals of a block depend on the shared parameters x and on its own y only. So a block needs
derivatives by x and y, not by the parameters of the other blocks. Its normal equations eliminate y
exactly (Schur's complement), which leaves a system of the size of x:

$$ \Bigl(A - \sum_b B_b C_b^{-1} B_b^T\Bigr)\,\delta x
   = -\sum_b \bigl(g_b - B_b C_b^{-1} h_b\bigr), \qquad
   \delta y_b = -C_b^{-1}\bigl(h_b + B_b^T \delta x\bigr). $$
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, PyTree

_MOST_STEPS = 12


def gauss_newton_in_blocks(
    residual: Callable[[Float[Array, "p"], Float[Array, "q"], Any], Float[Array, "n"]],
    shared: Float[Array, "p"],
    own: Float[Array, "blocks q"],
    blocks: PyTree,
    *,
    tolerance: float,
) -> tuple[Float[Array, "p"], Float[Array, "blocks q"], Bool[Array, ""]]:
    """Minimise the sum of squared residuals of all blocks.

    It compiles the residuals once, with p + q directions, and works under `jit` and `vmap`.

    Args:
        residual: of one block, over their sigma, priors of its own parameters included.
        shared: first guess of the shared parameters. Their priors are residuals of a block.
        own: first guess of each block's own parameters.
        blocks: data of the blocks, with a leading axis on every leaf.
        tolerance: largest last step, in the parameters' units.

    Returns:
        The shared parameters, each block's own, and whether the last step was within the tolerance.
    """
    p = shared.size

    def linearised(x: Array, y: Array, block: Any) -> tuple[Array, Array]:
        def along(direction: Array) -> tuple[Array, Array]:
            return jax.jvp(lambda z: residual(z[:p], z[p:], block), (z,), (direction,))

        z = jnp.concatenate([x, y])
        value, slopes = jax.vmap(along, out_axes=(None, 0))(jnp.eye(z.size))
        return slopes @ slopes.T, slopes @ value

    def step(state: tuple[Array, Array, Array, Array]) -> tuple[Array, Array, Array, Array]:
        x, y, _, count = state
        information, gradient = jax.vmap(linearised, (None, 0, 0))(x, y, blocks)
        mixed, inner = information[:, :p, p:], information[:, p:, p:]
        right = jnp.concatenate([mixed.swapaxes(1, 2), gradient[:, p:, None]], axis=2)
        solved = jnp.linalg.solve(inner, right)
        outer = jnp.sum(information[:, :p, :p] - mixed @ solved[..., :p], axis=0)
        pull = jnp.sum(gradient[:, :p] - (mixed @ solved[..., p:])[..., 0], axis=0)
        dx = -jnp.linalg.solve(outer, pull)
        dy = -(solved[..., p] + solved[..., :p] @ dx)
        longest = jnp.maximum(jnp.max(jnp.abs(dx)), jnp.max(jnp.abs(dy)))
        return x + dx, y + dy, longest, count + 1

    def unfinished(state: tuple[Array, Array, Array, Array]) -> Array:
        return (state[2] > tolerance) & (state[3] < _MOST_STEPS)

    start = shared, own, jnp.asarray(jnp.inf), jnp.asarray(0)
    x, y, longest, _ = jax.lax.while_loop(unfinished, step, start)
    return x, y, longest <= tolerance
