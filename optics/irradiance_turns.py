"""Turns of the edge of a cap's lit part: rings that it touches, or on which two limits meet."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float

from optics.lens_trace import BackwardRays

_RINGS, _TURNS = 16, 10  # cells of the search for turns of the edge
_STARTS = 4  # of the search, for each kind of turn
_STEPS, _LONGEST = 7, 0.25  # Newton steps towards a turn, and their bound
_AROUND = 0.5  # of the range that may be lit: its bounds are estimates
_CLOSE = 1e-6  # residual of a turn

# A turn is a zero of one limit and of its slope along the ring (touches), or of two limits.
# Limits: 0 cone, 1 face, 2 drop.
_FIRST, _SECOND = np.array([0, 0, 1, 0, 1, 2]), np.array([1, 2, 2, 0, 1, 2])
_TOUCHES = _FIRST == _SECOND

RingRays = Callable[[Array, Array], BackwardRays]


def find_turns(
    rays: RingRays, ring_at: Callable[[Array], Array]
) -> tuple[Bool[Array, "turns"], Array, Array, Array]:
    """Rings that the lit part's edge touches, and rings on which two limits meet on it.

    Whether each candidate is one, its ring, its tau, and the drift of the arc that opens there.

    Newton's method in two variables, from the cells of a grid that seem to contain a turn.

    Args:
        rays: rays by ring and tau.
        ring_at: ring by its share, in [0, 1], of the range that may be lit.
    """

    def limits(place):
        """All limits and their slopes along the ring, [limit, ...]."""

        def along(tau):
            light = rays(ring_at(place[0]), tau)
            return jnp.stack([light.cone, light.face, light.drop])

        return jax.jvp(along, (place[1],), (jnp.ones_like(place[1]),))

    sides = np.linspace(0.0, 1.0, _RINGS + 1), np.linspace(0.0, 1.0, _TURNS + 1)
    value, slope = limits(jnp.stack(jnp.meshgrid(*map(jnp.asarray, sides), indexing="ij")))
    place = _cell_roots(
        value[_FIRST],
        jnp.where(_TOUCHES[:, None, None], slope[_FIRST], value[_SECOND]),
        jnp.max(value, axis=0),
    )
    which = np.arange(place.shape[1])
    first_limit, second_limit, touches = (
        np.repeat(x, _STARTS) for x in (_FIRST, _SECOND, _TOUCHES)
    )

    def values(place):
        value, slope = limits(place)
        other = jnp.where(touches, slope[first_limit, which], value[second_limit, which])
        return value[first_limit, which], other, jnp.max(value, axis=0)

    def step(place):
        def along(direction):
            move = jnp.broadcast_to(direction[:, None], place.shape)
            return jax.jvp(values, (place,), (move,))

        (a, b, excess), (a_slope, b_slope, _) = jax.vmap(along, out_axes=(None, 0))(jnp.eye(2))
        (a_ring, a_tau), (b_ring, b_tau) = lax.stop_gradient((a_slope, b_slope))
        determinant = a_ring * b_tau - a_tau * b_ring
        correction = jnp.stack([b_tau * a - a_tau * b, a_ring * b - b_ring * a])
        correction /= _nonzero(determinant)
        correction = jnp.clip(correction, -_LONGEST, _LONGEST)
        is_turn = jnp.maximum(jnp.maximum(jnp.abs(a), jnp.abs(b)), excess) < _CLOSE
        ring, tau = place - correction
        place = jnp.stack([jnp.clip(ring, -_AROUND, 1.0 + _AROUND), jnp.clip(tau, 0.0, 1.0)])
        # Next to a touched ring the short arc lies around the zero of the slope, and next to a
        # meeting of two limits between their zeros.
        second = -b_ring / _nonzero(b_tau)
        drift = jnp.where(touches, second, 0.5 * (second - a_ring / _nonzero(a_tau)))
        return place, is_turn, drift

    place = lax.stop_gradient(place)
    place = lax.fori_loop(0, _STEPS, lambda _, place: step(place)[0], place)
    # Only the last step is differentiated; it gives the implicit function's derivative.
    place, is_turn, drift = step(lax.stop_gradient(place))
    ring, per_share = jax.jvp(ring_at, (place[0],), (jnp.ones_like(place[0]),))
    return is_turn, ring, *lax.stop_gradient((place[1], drift / _nonzero(per_share)))


def _cell_roots(
    first: Float[Array, "kinds n m"], second: Float[Array, "kinds n m"], excess: Float[Array, "n m"]
) -> Float[Array, "2 starts"]:
    """Common zeros of two functions by linear interpolation in the cells of a grid on [0, 1]².

    Of each kind, those that lie nearest to the middles of their cells, among lit cells.
    """

    def corners(values):
        left, right = values[..., :-1], values[..., 1:]
        return left[..., :-1, :], left[..., 1:, :], right[..., :-1, :], right[..., 1:, :]

    def plane(values):
        """Value in the middle of each cell, and its slopes per cell."""
        a, b, c, d = corners(values)
        return 0.25 * (a + b + c + d), 0.5 * (b + d - a - c), 0.5 * (c + d - a - b)

    (a, a_ring, a_tau), (b, b_ring, b_tau) = plane(first), plane(second)
    determinant = _nonzero(a_ring * b_tau - a_tau * b_ring)
    ring = -(b_tau * a - a_tau * b) / determinant
    tau = -(a_ring * b - b_ring * a) / determinant
    corner = jnp.stack(corners(excess))
    lit = 2.0 * jnp.min(corner, axis=0) < jnp.max(corner, axis=0)
    away = jnp.where(lit, jnp.maximum(jnp.abs(ring), jnp.abs(tau)), jnp.inf)
    rows, columns = lit.shape
    away = away.reshape(len(away), -1)
    chosen = smallest(away, _STARTS)
    ring, tau = (
        jnp.clip(jnp.take_along_axis(x.reshape(away.shape), chosen, axis=1), -1.0, 1.0)
        for x in (ring, tau)
    )
    return jnp.stack(
        [
            ((chosen // columns + 0.5 + ring) / rows).ravel(),
            jnp.clip((chosen % columns + 0.5 + tau) / columns, 0.0, 1.0).ravel(),
        ]
    )


def smallest(values: Float[Array, "*batch n"], count: int) -> Array:
    """Indices of the smallest values; sorting all of them would cost a fourth of the quadrature."""
    chosen = []
    for _ in range(count):
        chosen.append(jnp.argmin(values, axis=-1, keepdims=True))
        values = jnp.where(np.arange(values.shape[-1]) == chosen[-1], jnp.inf, values)
    return jnp.concatenate(chosen, axis=-1)


def _nonzero(x: Array) -> Array:
    return jnp.where(x == 0.0, 1.0, x)
