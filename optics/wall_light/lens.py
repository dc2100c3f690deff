"""Light of a glue lens on the wall behind pixels, from a table."""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

import optics
from optics.wall_light.pixel_light import WallPixels
from optics.wall_light.table import LensTable

_GAUSS = 3
"""Gauss nodes on each side of a pixel. With two, the mean of a pixel that a sharp edge cuts is off
by 0.4 % of the step (RMS), with three by 0.1 %."""
_SPREAD_RINGS, _SPREAD_DIRECTIONS = 4, 8  # of a lens's light, which is smooth


class Lens(eqx.Module):
    """A glue lens, given by a table of its light.

    Attributes:
        table: the lens's light near the parameters for which the table was computed.
        spread: L of the light's spread in the wall (`optics.truth`), mm, or None.
    """

    table: LensTable
    spread: Float[Array, ""] | None = None

    def irradiance(
        self, wall: WallPixels, *, tip: Float[Array, "3"], axis: Float[Array, "3"]
    ) -> Float[Array, "n"]:
        """Light that enters a pixel's patch of the wall, by the patch's area."""
        if self.spread is None:
            return self._direct(wall, tip=tip, axis=axis)
        first = wall.right / jnp.linalg.norm(wall.right, axis=-1, keepdims=True)
        second = jnp.cross(wall.normal, first)
        offsets, weights = optics.spread_nodes(rings=_SPREAD_RINGS, directions=_SPREAD_DIRECTIONS)
        nodes = jnp.asarray(np.column_stack([offsets, weights]))

        def added(total: Array, node: Array) -> tuple[Array, None]:
            aside = self.spread * (node[0] * first + node[1] * second)
            moved = wall._replace(point=wall.point + aside)
            return total + node[2] * self._direct(moved, tip=tip, axis=axis), None

        return jax.lax.scan(added, jnp.zeros(wall.coaxial.shape), nodes)[0]

    def _direct(
        self, wall: WallPixels, *, tip: Float[Array, "3"], axis: Float[Array, "3"]
    ) -> Float[Array, "n"]:
        """The line integral around each patch (see `table`)."""
        u, v, du, dv = (part[:, None, None] for part in _border())
        point = wall.point + u * wall.right + v * wall.down
        step = du * wall.right + dv * wall.down
        light = jnp.sum(self.table.passing(point, step, tip=tip, axis=axis), axis=0)
        # right x down points out of the eye, against the inward normal.
        return light / -optics.dot(wall.normal, jnp.cross(wall.right, wall.down))

    def lit(
        self, wall: WallPixels, *, tip: Float[Array, "3"], axis: Float[Array, "3"]
    ) -> Float[Array, "n"]:
        """1 everywhere: the irradiance contains the edges of a lens's light."""
        return jnp.ones(wall.coaxial.shape)

    def emitted(self) -> Float[Array, ""]:
        """Fraction of the power that leaves the cap."""
        return self.table.transmitted()


def _border() -> Float[np.ndarray, "4 nodes"]:
    """Nodes (u, v) around a pixel, px from its centre, and their steps (du, dv) with weights."""
    node, weight = (part / 2 for part in np.polynomial.legendre.leggauss(_GAUSS))
    right = np.stack([np.full(_GAUSS, 0.5), node, 0 * node, weight])
    # A quarter turn leads from each side to the next.
    turn = np.kron(np.eye(2), [[0.0, -1.0], [1.0, 0.0]])
    sides = [np.linalg.matrix_power(turn, k) @ right for k in range(4)]
    return np.concatenate(sides, axis=1)
