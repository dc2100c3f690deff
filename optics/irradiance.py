r"""Vector irradiance of a glue lens at a wall point, by quadrature.

$\mathbf V(X) = \int L\,\boldsymbol\omega\,d\omega$ over the part of the cap that is lit when seen
from X, with $L = L_0\,T\,(n_0/n_g)^2$: radiance is conserved along a ray except for $n^2$ and the
Fresnel loss. The cone, the core and the rim bound the lit part; spherical aberration gives it the
shape of crescents and rings. The quadrature runs over rings of the cap around the axis, and on each
ring over its lit arcs. The ends of the arcs are found by root finding, so the integrand is smooth
and the derivatives include the motion of the ends.

At some rings the lit part changes its form. Between two such breaks the bounds of a ring's lit arcs
are smooth, so a Gaussian rule over the rings converges. A break lies where the lit part's edge
crosses the meridian through the wall point, where it touches a ring, or where it passes from one
limit of the light to another.
"""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.typing import ArrayLike
from jaxtyping import Array, Bool, Float, PyTree

from eyespot.optics.irradiance_edges import (
    RingRange,
    RingRays,
    approach_extremes,
    find_turns,
    implicit_root,
    scan_boundaries,
    settle,
    smallest,
)
from eyespot.optics.lens import GlueLens

_MERIDIAN = 160  # cells of the scan along the meridian
_ZOOMED_CELLS = 16  # cells of the second scan, for a lit part smaller than a cell
_EXTREMES = 3  # extremes of the excess along the meridian that may cross zero between two samples
_PINCHES = 2  # pinches of the lit part across the meridian
_CROSSINGS = 8  # crossings of the meridian and the lit part's edge, for a disc and a ring
_COARSE, _COARSE_TURNS = 33, 11  # samples of the scan of whole rings
_MARGIN_SAMPLES = 2  # the lit part may reach so far beyond the outermost lit sample
_EQUAL_TURNS = 1e-6  # distance over the aperture below which two candidates are one turn
_MAX_BREAKS = 11  # kept of all candidates; more do not occur together


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
    zoomed = still_whole.place(near + cell * np.linspace(-1.0, 1.0, _ZOOMED_CELLS + 1))
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
    same = jnp.abs(breaks[:, None] - breaks) < _EQUAL_TURNS * aperture
    found &= ~jnp.any(np.tri(found.size, k=-1, dtype=bool) & same & found, axis=1)
    chosen = jnp.argsort(~found)[:_MAX_BREAKS]
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
        return jnp.where((np.arange(_MAX_BREAKS) == number) & ~used, middle, breaks)

    return lax.fori_loop(0, _MAX_BREAKS, halve, breaks)


def _lit_rings(
    rays: RingRays, ring: Float[Array, "rings"], inner: Array, outer: Array
) -> tuple[Array, Array, Array, Array]:
    """Bounds of the rings that may be lit, and of those seen lit, from a scan of whole rings.

    On the meridian `inner` is the first lit one and `outer` the last; they are equal if none is.
    """
    tau = np.linspace(0.0, 1.0, _COARSE_TURNS)[:, None]
    darkness = jnp.min(rays(ring, jnp.broadcast_to(tau, (tau.size, ring.size))).excess, axis=0)
    # The lit part may begin between the samples, or lie between two of them.
    lit = (darkness < 0.0) | (darkness == jnp.min(darkness))
    before = jnp.concatenate([jnp.repeat(ring[:1], _MARGIN_SAMPLES), ring[:-_MARGIN_SAMPLES]])
    after = jnp.concatenate([ring[_MARGIN_SAMPLES:], jnp.repeat(ring[-1:], _MARGIN_SAMPLES)])
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


_RINGS = 6  # Gauss-Legendre nodes between two breaks
_CELLS = 9  # cells of the scan along half a ring, in each of three stretches
_ARC = 5  # Gauss-Legendre nodes on an arc
_POINTS_PER_CALL = 64  # wall points per call, few enough to stay in the cache


def vector_irradiance(
    lens: GlueLens, *, medium_index: ArrayLike, radius: ArrayLike, distance: ArrayLike
) -> tuple[Float[Array, "*batch"], Float[Array, "*batch"]]:
    r"""Vector irradiance V of a lens at wall points, per unit power in the core.

    A wall with inward unit normal **n** receives exactly E = -**n**·**V** if the whole cap is in
    front of it. Light that the cap reflects back into the glue is lost.

    Args:
        medium_index: n0, refractive index of the medium.
        radius: distance of the wall point from the axis, mm.
        distance: s, distance of the wall point from the tip along the axis, mm, positive.

    Returns:
        V_rho and V_s, 1/mm². Both are 0 where no light arrives.
    """
    radius, distance = jnp.broadcast_arrays(
        jnp.asarray(radius, dtype=float), jnp.asarray(distance, dtype=float)
    )
    medium_index = jnp.asarray(medium_index, dtype=float)
    size = radius.size
    if size == 0:
        return jnp.zeros(radius.shape), jnp.zeros(radius.shape)
    wall = jnp.stack([radius.ravel(), distance.ravel()])
    leaves = jax.tree.leaves((lens, medium_index, wall))
    if any(isinstance(leaf, jax.core.Tracer) for leaf in leaves):
        width = min(size, _POINTS_PER_CALL)
        filled = jnp.pad(wall, ((0, 0), (0, -size % width)), mode="edge")
        batches = filled.reshape(2, -1, width).transpose(1, 0, 2)
        field = lax.map(lambda batch: _batch_field(lens, medium_index, *batch), batches)
        field = field.transpose(1, 0, 2).reshape(2, -1)[:, :size]
    else:
        values = values_at(partial(_batch_field, lens, medium_index), np.asarray(wall))
        field = jnp.asarray(values)
    return field[0].reshape(radius.shape), field[1].reshape(radius.shape)


def in_batches(function: Callable[[Any], Any], items: PyTree, *, size: int) -> PyTree:
    """Results of a function that treats arrays with a leading axis item by item.

    All batches have one shape, the last one filled up with its last item, so that it is compiled
    once. One batch is too small for several cores, so each core takes a batch of its own.
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


def values_at(
    evaluate: Callable[..., np.ndarray | Array], points: Float[np.ndarray, "2 n"]
) -> Float[np.ndarray, "k n"]:
    """Values of a compiled function at points, k x n; whole batches for any number of them."""
    return in_batches(lambda batch: evaluate(*batch.T).T, points.T, size=_POINTS_PER_CALL).T


@jax.jit
@partial(jax.vmap, in_axes=(None, None, 0, 0), out_axes=1)
def _batch_field(lens: GlueLens, medium_index, radius, distance) -> Float[Array, "2"]:
    """V at wall points, each on its own."""
    rays = RingRays(lens, medium_index, radius, distance)
    breaks = ring_breaks(rays)
    node, weight = np.polynomial.legendre.leggauss(_RINGS)
    # At a break an arc opens and closes like a square root; the cosine makes this smooth.
    turn = 0.5 * np.pi * (node + 1.0)
    share, share_weight = 0.5 - 0.5 * np.cos(turn), 0.25 * np.pi * np.sin(turn) * weight
    start, width = breaks.ring[:-1, None], jnp.diff(breaks.ring)[:, None]
    ring, ring_weight = (start + width * share).ravel(), (width * share_weight).ravel()

    # Axes from here on: node of an arc, arc, ring.
    node, weight = np.polynomial.legendre.leggauss(_ARC)
    node, weight = node[:, None, None], weight[:, None, None]
    arcs = _lit_arcs(rays, ring, _openings(breaks, share).reshape(2, -1))
    first, last = _quarter_tangent(rays.haversine(ring, arcs))
    half = 0.5 * (last - first)
    tangent = first + half * (1.0 + node)
    stretch = 1.0 + jnp.square(tangent)
    light = rays.trace(ring, jnp.square(2.0 * tangent / stretch))
    # The factor 2 adds the half of the ring on the other side of the meridional plane.
    area = 2.0 * ring * ring_weight * (4.0 * half / stretch) * weight
    return jnp.stack([jnp.sum(area * light.lateral), jnp.sum(area * light.axial)])


def _openings(breaks: Breaks, share: Float[np.ndarray, "nodes"]) -> Float[Array, "2 intervals n"]:
    """Places in [0, 1] of short arcs on each ring, from the openings before and after it."""
    number = jnp.arange(breaks.ring.size)
    last = number[-1]
    before = lax.cummax(jnp.where(breaks.opens, number, 0))[:-1, None]
    after = lax.cummin(jnp.where(breaks.opens, number, last), reverse=True)[1:, None]
    ring = breaks.ring[:-1, None] + jnp.diff(breaks.ring)[:, None] * share
    nearest = jnp.stack([before, after])
    place = breaks.tau[nearest] + breaks.drift[nearest] * (ring - breaks.ring[nearest])
    middle = np.array([1 / 3, 2 / 3])[:, None, None]  # for a ring without an opening on one side
    return lax.stop_gradient(jnp.clip(jnp.where(breaks.opens[nearest], place, middle), 0.0, 1.0))


def _lit_arcs(
    rays: RingRays, ring: Float[Array, "rings"], openings: Float[Array, "2 rings"]
) -> Float[Array, "2 2 rings"]:
    """First and last tau in [0, 1] of the at most two lit arcs of half a ring; may be empty.

    At the `openings` an arc can be shorter than the scan's cells.
    """

    def excess(tau: Array) -> Array:
        return rays(ring, tau).excess

    still_rays, still_ring = lax.stop_gradient((rays, ring))

    def searched(tau: Array) -> Array:
        return still_rays(still_ring, tau).excess

    # Short arcs lie at the openings, or near the meridian, where both edges of the lit part bend.
    low, high = jnp.min(openings, axis=0), jnp.max(openings, axis=0)
    rings = low.size
    start = jnp.stack([jnp.zeros(rings), low, high])
    width = jnp.stack([low, high - low, 1.0 - high])
    fraction = np.sin(np.linspace(0.0, 0.5 * np.pi, _CELLS, endpoint=False)) ** 2
    tau = (start[:, None] + width[:, None] * fraction[:, None]).reshape(-1, rings)
    tau = jnp.append(tau, jnp.ones((1, rings)), axis=0)
    tau, values = approach_extremes(searched, tau, searched(tau), count=1)
    found, lit, dark = scan_boundaries(tau, values, count=3)
    root = jnp.clip(implicit_root(excess, settle(searched, lit, dark)), 0.0, 1.0)
    zero = jnp.zeros(rings)
    one, two, three = jnp.where(found, root, 1.0)
    from_lit = jnp.stack([jnp.stack([zero, two]), jnp.stack([one, three])])
    from_dark = jnp.stack([jnp.stack([one, three]), jnp.stack([two, zero + 1.0])])
    return jnp.where(values[0] < 0.0, from_lit, from_dark)


def _quarter_tangent(haversine: Array) -> Array:
    """tan(phi/4) from sin²(phi/2), with a zero derivative at the ends 0 and pi.

    As a variable of integration it is as smooth as phi, but needs no sines, which are slow.
    """
    inside = (haversine > 0.0) & (haversine < 1.0)
    safe = jnp.where(inside, haversine, 0.5)
    tangent = jnp.sqrt(safe) / (1.0 + jnp.sqrt(1.0 - safe))
    return jnp.where(inside, tangent, jnp.where(haversine > 0.5, 1.0, 0.0))
