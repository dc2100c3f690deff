"""Rings of a cap at which its lit part changes its form, when seen from a wall point.

Between two such breaks the bounds of a ring's lit arcs are smooth, so a Gaussian rule over the
rings converges. A break lies where the lit part's edge crosses the meridian through the wall point,
where it touches a ring, or where it passes from one limit of the light to another.
"""

from functools import partial
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float

from optics.irradiance_edges import approach_extremes, implicit_root, scan_boundaries, settle
from optics.irradiance_turns import RingRange, RingRays, find_turns, smallest

_MERIDIAN = 160  # cells of the scan along the meridian
_ZOOM = 16  # cells of the second scan, for a lit part smaller than a cell
_EXTREMES = 3  # of the excess along the meridian that may pass zero between two samples
_PINCHES = 2  # of the lit part across the meridian
_CROSSINGS = 8  # of the meridian with the lit part's edge, for a disc and a ring
_COARSE, _COARSE_TURNS = 33, 11  # samples of the scan of whole rings
_BEYOND = 2  # of these samples, to which the lit part may reach beyond the outermost lit one
_SAME = 1e-6  # of the aperture: two candidates are one turn
_BREAKS = 11  # kept of all candidates; more do not occur together


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


def ring_breaks(rays: RingRays) -> Breaks:
    """Rings of the cap at which the number or the bounds of lit arcs change, with both ends.

    Breaks have derivatives, because a whole arc ends at a break if the core's edge is along a ring.

    Args:
        rays: rays from the wall point.
    """
    aperture = rays.lens.aperture_radius
    still = lax.stop_gradient(rays)

    def excess(x, rays=rays):
        return rays(jnp.abs(x), jnp.where(x < 0.0, 1.0, 0.0)).excess

    searched = partial(excess, rays=still)

    # Samples are nearly equidistant in the angle seen from the wall point. So they resolve the lit
    # part for near wall points (small) and for far ones (the whole aperture). At the aperture
    # itself light can be exactly at the core's limit although the strip next to it is lit.
    end = aperture * (1.0 - 1e-6)
    gap = rays.distance + rays.lens.sagitta(jnp.minimum(rays.radius, end))
    zero = 0.0 * aperture
    whole = RingRange(rays.radius, gap, end, zero, zero).between(-aperture, aperture)
    angle = whole.angle

    still_whole = lax.stop_gradient(whole)
    even = still_whole(jnp.linspace(0.0, 1.0, _MERIDIAN + 1))
    x, values = approach_extremes(searched, even, searched(even), count=_EXTREMES)
    cell = (still_whole.high - still_whole.low) / _MERIDIAN
    near = still_whole.angle(x[jnp.argmin(values)])
    zoomed = still_whole.place(near + cell * np.linspace(-1.0, 1.0, _ZOOM + 1))
    resolved = jnp.any(values < 0.0)
    found, lit, dark = (
        jnp.where(resolved, coarse, fine)
        for coarse, fine in zip(
            scan_boundaries(x, values, count=_CROSSINGS),
            scan_boundaries(zoomed, searched(zoomed), count=_CROSSINGS),
            strict=True,
        )
    )
    crossing = jnp.abs(implicit_root(excess, settle(searched, lit, dark)))
    reaches_rim = (values[0] < 0.0) | (values[-1] < 0.0)
    inner = jnp.where(jnp.any(found), jnp.min(jnp.where(found, crossing, aperture)), 0.0)
    outer = jnp.where(reaches_rim, aperture, jnp.max(jnp.where(found, crossing, 0.0)))
    # The rings round the axis are lit if it is.
    inner = jnp.where(searched(jnp.zeros(())) < 0.0, 0.0, jnp.minimum(inner, outer))
    outer = jnp.maximum(inner, outer)

    # Off the meridian rings are lit that are dark on it, where the edge bends away from a ring.
    ring = lax.stop_gradient(whole.between(zero, end)(jnp.linspace(0.0, 1.0, _COARSE)))
    low, high, innermost, outermost = _lit_rings(still, ring, inner, outer)
    is_turn, turn, tau, drift = find_turns(rays, whole.between(low, high))
    # A lit part off the meridian may lack turns, if it reaches the rim.
    inner, outer = jnp.where(outer > inner, jnp.stack([inner, outer]), jnp.stack([low, high]))
    first = jnp.minimum(innermost, jnp.minimum(inner, jnp.min(jnp.where(is_turn, turn, inner))))
    last = jnp.maximum(outermost, jnp.maximum(outer, jnp.max(jnp.where(is_turn, turn, outer))))
    # Where the lit part is nearly pinched off, its arcs change their form within few rings.
    middle = jnp.where(values[1:-1] < 0.0, values[1:-1], -jnp.inf)
    middle = jnp.where((middle >= values[:-2]) & (middle > values[2:]), middle, -jnp.inf)
    highest = smallest(-middle, _PINCHES)
    pinch, is_pinch = even[1:-1][highest], middle[highest] > -jnp.inf
    # Few of the candidates exist. Unused breaks halve the widest intervals.
    bounds = jnp.stack([first, last])
    found = jnp.concatenate([found, is_turn, (bounds > 0.0) & (bounds < aperture), is_pinch])
    breaks = jnp.concatenate([crossing, turn, bounds, jnp.abs(pinch)])
    same = jnp.abs(breaks[:, None] - breaks) < _SAME * aperture
    found &= ~jnp.any(np.tri(found.size, k=-1, dtype=bool) & same & found, axis=1)
    chosen = jnp.argsort(~found)[:_BREAKS]
    used = found[chosen]
    ends = angle(bounds)
    divided = _divided(jnp.where(used, angle(breaks[chosen]), ends[0]), used, ends)
    breaks = jnp.where(used, breaks[chosen], whole.place(divided))
    ring = jnp.append(jnp.clip(breaks, 0.0, aperture), jnp.stack([0.0 * aperture, aperture]))
    order = jnp.argsort(ring)
    turns = slice(crossing.size, crossing.size + turn.size)

    def in_order(of_turns: Array) -> Array:
        every = jnp.zeros(found.size, of_turns.dtype).at[turns].set(of_turns)
        return jnp.append(every[chosen], jnp.zeros(2, of_turns.dtype))[order]

    return Breaks(ring[order], in_order(found[turns]), in_order(tau), in_order(drift))


def _divided(breaks: Float[Array, "breaks"], used: Bool[Array, "breaks"], ends: Array) -> Array:
    """The breaks, with unused ones in the middles of the widest intervals."""

    def halve(number, breaks):
        every = jnp.append(breaks, ends)
        after = jnp.min(jnp.where(every > every[:, None], every, jnp.inf), axis=1)
        width = jnp.where(after < jnp.inf, after - every, 0.0)
        # Of two halves the outer one is divided first, whatever rounding makes of their widths.
        widest = jnp.argmax(width * (1.0 + 1e-3 * every))
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
        inner: first ring lit on the meridian.
        outer: last one; equal to the first if none is lit.
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
