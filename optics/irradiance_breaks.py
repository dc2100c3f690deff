"""Rings of a cap at which its lit part changes its form, when seen from a wall point.

Between two such breaks the bounds of a ring's lit arcs are smooth, so a Gaussian rule over the
rings converges. A break lies where the lit part's edge crosses the meridian through the wall point,
where it touches a ring, or where it passes from one limit of the light to another.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.typing import ArrayLike
from jaxtyping import Array, Bool, Float

from optics.irradiance_edges import approach_extremes, implicit_root, scan_boundaries, settle
from optics.lens import GlueLens
from optics.lens_trace import BackwardRays

_MERIDIAN = 160  # cells of the scan along the meridian
_ZOOM = 16  # cells of the second scan, for a lit part smaller than a cell
_EXTREMES = 3  # of the excess along the meridian that may pass zero between two samples
_PINCHES = 2  # of the lit part across the meridian
_CROSSINGS = 8  # of the meridian with the lit part's edge, for a disc and a ring
_COARSE, _COARSE_TURNS = 33, 11  # samples of the scan of whole rings
_BEYOND = 2  # of these samples, to which the lit part may reach beyond the outermost lit one
_RINGS, _TURNS = 16, 10  # cells of the search for turns of the edge
_STARTS = 4  # of the search, for each kind of turn
_STEPS, _LONGEST = 7, 0.25  # Newton steps towards a turn, and their bound
_AROUND = 0.5  # of the range that may be lit: its bounds are estimates
_CLOSE = 1e-6  # residual of a turn
_SAME = 1e-6  # of the aperture: two candidates are one turn
_BREAKS = 11  # kept of all candidates; more do not occur together

# A turn is a zero of one limit and of its slope along the ring (touches), or of two limits.
# Limits: 0 cone, 1 face, 2 drop.
_FIRST, _SECOND = np.array([0, 0, 1, 0, 1, 2]), np.array([1, 2, 2, 0, 1, 2])
_TOUCHES = _FIRST == _SECOND

RingRays = Callable[[Array, Array], BackwardRays]


class Breaks(NamedTuple):
    """Breaks in order, and where the lit part opens at those that lie off the meridian.

    Attributes:
        ring: radii on the cap, mm, from 0 to the aperture.
        opens: whether the lit part opens at a known place of this ring.
        tau: this place, in [0, 1]. An arc around it is short on the rings next to it.
        drift: derivative of the arc's place along the rings, 1/mm.
    """

    ring: Float[Array, "breaks"]
    opens: Bool[Array, "breaks"]
    tau: Float[Array, "breaks"]
    drift: Float[Array, "breaks"]


def ring_breaks(
    lens: GlueLens, rays: RingRays, *, radius: ArrayLike, distance: ArrayLike
) -> Breaks:
    """Rings of the cap at which the number or the bounds of lit arcs change, with both ends.

    Breaks have derivatives, because a whole arc ends at a break if the core's edge is along a ring.

    Args:
        lens: the lens.
        rays: rays to the wall point from (radius on the cap, tau), tau running over half a ring
            from 0 on the wall point's side to 1.
        radius: distance of the wall point from the axis, mm.
        distance: distance of the wall point from the tip's plane, mm.
    """
    aperture = jnp.asarray(lens.aperture_radius)

    def excess(x):
        return rays(jnp.abs(x), jnp.where(x < 0.0, 1.0, 0.0)).excess

    # Samples are nearly equidistant in the angle seen from the wall point. So they resolve the lit
    # part for near wall points (small) and for far ones (the whole aperture). At the aperture
    # itself light can be exactly at the core's limit although the strip next to it is lit.
    end = aperture * (1.0 - 1e-6)
    gap = distance + lens.sagitta(jnp.minimum(radius, end))

    def angle(x):
        return _half_tangent((x - radius) / gap)

    def place(tangent):
        x = radius + gap * 2.0 * tangent / (1.0 - jnp.square(tangent))
        return jnp.clip(x, -end, end)

    def spread(first, last, count):
        return place(angle(first) + (angle(last) - angle(first)) * np.linspace(0.0, 1.0, count))

    x = spread(-aperture, aperture, _MERIDIAN + 1)
    x, values = approach_extremes(excess, x, excess(x), count=_EXTREMES)
    cell = (angle(aperture) - angle(-aperture)) / _MERIDIAN
    near = angle(x[jnp.argmin(values)])
    zoomed = place(near + cell * np.linspace(-1.0, 1.0, _ZOOM + 1))
    resolved = jnp.any(values < 0.0)
    found, lit, dark = (
        jnp.where(resolved, coarse, fine)
        for coarse, fine in zip(
            scan_boundaries(x, values, count=_CROSSINGS),
            scan_boundaries(zoomed, excess(zoomed), count=_CROSSINGS),
            strict=True,
        )
    )
    crossing = jnp.abs(implicit_root(excess, settle(excess, lit, dark)))
    reaches_rim = (values[0] < 0.0) | (values[-1] < 0.0)
    inner = jnp.where(jnp.any(found), jnp.min(jnp.where(found, crossing, aperture)), 0.0)
    outer = jnp.where(reaches_rim, aperture, jnp.max(jnp.where(found, crossing, 0.0)))
    # The rings round the axis are lit if it is.
    inner = jnp.where(excess(jnp.zeros(())) < 0.0, 0.0, jnp.minimum(inner, outer))
    outer = jnp.maximum(inner, outer)

    # Off the meridian rings are lit that are dark on it, where the edge bends away from a ring.
    ring = spread(0.0 * aperture, end, _COARSE)
    low, high, innermost, outermost = _lit_rings(rays, ring, inner, outer)

    def ring_at(share):
        return place(angle(low) + (angle(high) - angle(low)) * share)

    is_turn, turn, tau, drift = _turns(rays, ring_at)
    # A lit part off the meridian may lack turns, if it reaches the rim.
    inner, outer = jnp.where(outer > inner, jnp.stack([inner, outer]), jnp.stack([low, high]))
    first = jnp.minimum(innermost, jnp.minimum(inner, jnp.min(jnp.where(is_turn, turn, inner))))
    last = jnp.maximum(outermost, jnp.maximum(outer, jnp.max(jnp.where(is_turn, turn, outer))))
    # Where the lit part is nearly pinched off, its arcs change their form within few rings.
    middle = jnp.where(values[1:-1] < 0.0, values[1:-1], -jnp.inf)
    middle = jnp.where((middle >= values[:-2]) & (middle > values[2:]), middle, -jnp.inf)
    highest = _smallest(-middle, _PINCHES)
    pinch, is_pinch = lax.stop_gradient(x[1:-1][highest]), middle[highest] > -jnp.inf
    # Few of the candidates exist. Unused breaks halve the widest intervals.
    bounds = lax.stop_gradient(jnp.stack([first, last]))
    found = jnp.concatenate([found, is_turn, (bounds > 0.0) & (bounds < aperture), is_pinch])
    breaks = jnp.concatenate([crossing, turn, bounds, jnp.abs(pinch)])
    same = jnp.abs(breaks[:, None] - breaks) < _SAME * aperture
    found &= ~jnp.any(np.tri(found.size, k=-1, dtype=bool) & same & found, axis=1)
    chosen = jnp.argsort(~found)[:_BREAKS]
    used = found[chosen]
    ends = lax.stop_gradient(angle(bounds))
    divided = lax.stop_gradient(jnp.where(used, angle(breaks[chosen]), ends[0]))
    divided = _divided(divided, used, ends)
    breaks = jnp.where(used, breaks[chosen], place(divided))
    ring = jnp.append(jnp.clip(breaks, 0.0, aperture), jnp.stack([0.0 * aperture, aperture]))
    order = jnp.argsort(ring)
    turns = slice(crossing.size, crossing.size + turn.size)

    def in_order(of_turns: Array) -> Array:
        every = jnp.zeros(found.size, of_turns.dtype).at[turns].set(of_turns)
        return jnp.append(every[chosen], jnp.zeros(2, of_turns.dtype))[order]

    return Breaks(ring[order], in_order(found[turns]), in_order(tau), in_order(drift))


def _divided(breaks: Float[Array, "breaks"], used: Bool[Array, "breaks"], ends: Array) -> Array:
    """The breaks, with unused ones in the middles of the widest intervals; without derivatives."""

    def halve(number, breaks):
        every = jnp.append(breaks, ends)
        after = jnp.min(jnp.where(every > every[:, None], every, jnp.inf), axis=1)
        width = jnp.where(after < jnp.inf, after - every, 0.0)
        widest = jnp.argmax(width)
        middle = every[widest] + 0.5 * width[widest]
        return jnp.where((np.arange(_BREAKS) == number) & ~used, middle, breaks)

    return lax.fori_loop(0, _BREAKS, halve, breaks)


def _lit_rings(
    rays: RingRays, ring: Float[Array, "rings"], inner: Array, outer: Array
) -> tuple[Array, Array, Array, Array]:
    """Bounds of the rings that may be lit, and of those seen lit, from a scan of whole rings.

    Args:
        rays: rays by ring and tau.
        ring: rings to scan.
        inner, outer: bounds of the rings lit on the meridian; equal if none is.
    """
    tau = np.linspace(0.0, 1.0, _COARSE_TURNS)[:, None]
    darkness = jnp.min(rays(ring, jnp.broadcast_to(tau, (tau.size, ring.size))).excess, axis=0)
    # The lit part may begin between the samples, or lie between two of them.
    lit = (darkness < 0.0) | (darkness == jnp.min(darkness))
    before = jnp.concatenate([jnp.repeat(ring[:1], _BEYOND), ring[:-_BEYOND]])
    after = jnp.concatenate([ring[_BEYOND:], jnp.repeat(ring[-1:], _BEYOND)])
    low = jnp.min(jnp.where(lit, before, ring[-1]))
    high = jnp.max(jnp.where(lit, after, ring[0]))
    any_lit = outer > inner
    low, high = (
        jnp.where(any_lit, jnp.minimum(low, inner), low),
        jnp.where(any_lit, jnp.maximum(high, outer), high),
    )
    innermost = jnp.min(jnp.where(darkness < 0.0, ring, high))
    outermost = jnp.max(jnp.where(darkness < 0.0, ring, low))
    return lax.stop_gradient((low, high, innermost, outermost))


def _turns(
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
        return values[..., :-1, :-1], values[..., 1:, :-1], values[..., :-1, 1:], values[..., 1:, 1:]

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
    chosen = _smallest(away, _STARTS)
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


def _smallest(values: Float[Array, "*batch n"], count: int) -> Array:
    """Indices of the smallest values; sorting all of them would cost a fourth of the quadrature."""
    chosen = []
    for _ in range(count):
        chosen.append(jnp.argmin(values, axis=-1, keepdims=True))
        values = jnp.where(np.arange(values.shape[-1]) == chosen[-1], jnp.inf, values)
    return jnp.concatenate(chosen, axis=-1)


def _nonzero(x: Array) -> Array:
    return jnp.where(x == 0.0, 1.0, x)


def _half_tangent(tangent: Array) -> Array:
    """tan(x/2) from tan(x)."""
    return tangent / (1.0 + jnp.sqrt(1.0 + jnp.square(tangent)))
