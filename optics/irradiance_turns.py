"""Turns of the edge of a cap's lit part: rings that it touches, or on which two limits meet."""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float

from optics.lens import GlueLens
from optics.lens_trace import BackwardRays, trace_backwards

_RINGS, _TURNS = 16, 10  # cells of the search for turns of the edge
_STARTS = 4  # of the search, for each kind of turn
_STEPS, _LONGEST = 7, 0.25  # Newton steps towards a turn, and their bound
_AROUND = 0.5  # of the range that may be lit: its bounds are estimates
_CLOSE = 1e-6  # residual of a turn

# A turn is a zero of one limit and of its slope along the ring (touches), or of two limits.
# Limits: 0 cone, 1 face, 2 drop.
_FIRST, _SECOND = np.array([0, 0, 1, 0, 1, 2]), np.array([1, 2, 2, 0, 1, 2])
_TOUCHES = _FIRST == _SECOND


class RingRays(eqx.Module):
    """Rays from a wall point backwards through points of half a ring of the cap.

    A search for a boundary needs no derivatives: it uses `lax.stop_gradient` of this object, since
    to differentiate its steps only to discard the result takes most of the time of compilation.

    Attributes:
        lens: the lens.
        medium_index: n0.
        radius: distance of the wall point from the axis, mm.
        distance: distance of the wall point from the tip's plane, mm.
    """

    lens: GlueLens
    medium_index: Array
    radius: Array
    distance: Array

    def __call__(self, ring: Array, tau: Array) -> BackwardRays:
        """Rays by ring, mm, and tau, from 0 on the wall point's side to 1."""
        return self.trace(ring, self.haversine(ring, tau))

    def haversine(self, ring: Array, tau: Array) -> Array:
        """sin²(phi/2) of the angle around the axis.

        With this Möbius map the squared sine at the wall point is linear along a ring, for near and
        far wall points, so a few Newton steps find a root.
        """
        depth = self.distance + self.lens.sagitta(ring)
        gap_squared = jnp.square(self.radius - ring) + jnp.square(depth)
        return tau / (1.0 + 4.0 * self.radius * ring / gap_squared * (1.0 - tau))

    def trace(self, ring: Array, haversine: Array) -> BackwardRays:
        """Rays by ring, mm, and sin²(phi/2)."""
        return trace_backwards(
            self.lens,
            medium_index=self.medium_index,
            radius=self.radius,
            distance=self.distance,
            cap_radius=ring,
            haversine=haversine,
        )


class RingRange(eqx.Module):
    """Rings of a cap by their share of a range, even in the angle seen from the wall point.

    Attributes:
        radius: distance of the wall point from the axis, mm.
        gap: distance of the wall point from the cap, mm.
        end: largest ring, mm.
        low, high: half tangents of the range's angles.
    """

    radius: Array
    gap: Array
    end: Array
    low: Array
    high: Array

    def __call__(self, share: Array) -> Array:
        """Rings, mm, negative beyond the axis."""
        return self.place(self.low + (self.high - self.low) * share)

    def place(self, tangent: Array) -> Array:
        """Ring by the half tangent of its angle."""
        x = self.radius + self.gap * 2.0 * tangent / (1.0 - jnp.square(tangent))
        return jnp.clip(x, -self.end, self.end)

    def angle(self, x: Array) -> Array:
        """Half tangent of a ring's angle."""
        tangent = (x - self.radius) / self.gap
        return tangent / (1.0 + jnp.sqrt(1.0 + jnp.square(tangent)))

    def between(self, first: Array, last: Array) -> RingRange:
        """The range between two rings."""
        ends = self.angle(first), self.angle(last)
        return RingRange(self.radius, self.gap, self.end, *ends)


def find_turns(
    rays: RingRays, ring_at: RingRange
) -> tuple[Bool[Array, "turns"], Array, Array, Array]:
    """Rings that the lit part's edge touches, and rings on which two limits meet on it.

    Whether each candidate is one, its ring, its tau, and the drift of the arc that opens there.

    Newton's method in two variables, from the cells of a grid that seem to contain a turn.

    Args:
        rays: rays by ring and tau.
        ring_at: the range that may be lit.
    """
    still = lax.stop_gradient((rays, ring_at))

    def limits(place, rays, ring_at):
        """All limits and their slopes along the ring, [limit, ...]."""

        def along(tau):
            light = rays(ring_at(place[0]), tau)
            return jnp.stack([light.cone, light.face, light.drop])

        return jax.jvp(along, (place[1],), (jnp.ones_like(place[1]),))

    sides = np.linspace(0.0, 1.0, _RINGS + 1), np.linspace(0.0, 1.0, _TURNS + 1)
    value, slope = limits(jnp.stack(jnp.meshgrid(*map(jnp.asarray, sides), indexing="ij")), *still)
    place = _cell_roots(
        value[_FIRST],
        jnp.where(_TOUCHES[:, None, None], slope[_FIRST], value[_SECOND]),
        jnp.max(value, axis=0),
    )
    which = np.arange(place.shape[1])
    first_limit, second_limit, touches = (
        np.repeat(x, _STARTS) for x in (_FIRST, _SECOND, _TOUCHES)
    )

    def values(place, *world):
        value, slope = limits(place, *world)
        other = jnp.where(touches, slope[first_limit, which], value[second_limit, which])
        return value[first_limit, which], other, jnp.max(value, axis=0)

    def step(place, *world):
        def along(direction):
            move = jnp.broadcast_to(direction[:, None], place.shape)
            return jax.jvp(lambda place: values(place, *world), (place,), (move,))

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
    place = lax.fori_loop(0, _STEPS, lambda _, place: step(place, *still)[0], place)
    # Only the last step is differentiated; it gives the implicit function's derivative.
    place, is_turn, drift = step(lax.stop_gradient(place), rays, ring_at)
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
