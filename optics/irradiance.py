r"""Vector irradiance of a glue lens at a wall point, by quadrature.

$\mathbf V(X) = \int L\,\boldsymbol\omega\,d\omega$ over the part of the cap that is lit when seen
from X, with $L = L_0\,T\,(n_0/n_g)^2$: radiance is conserved along a ray except for $n^2$ and the
Fresnel loss. The cone, the core and the rim bound the lit part; spherical aberration gives it the
shape of crescents and rings. The quadrature runs over rings of the cap around the axis, and on each
ring over its lit arcs. The ends of the arcs are found by root finding, so the integrand is smooth
and the derivatives include the motion of the ends.
"""

from concurrent.futures import ThreadPoolExecutor
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from optics.irradiance_breaks import Breaks, ring_breaks
from optics.irradiance_edges import (
    approach_extremes,
    implicit_root,
    scan_boundaries,
    settle,
)
from optics.irradiance_turns import RingRays
from optics.lens import GlueLens

_RINGS = 6  # Gauss-Legendre nodes between two breaks
_CELLS = 9  # cells of the scan along half a ring, in each of three stretches
_ARC = 5  # Gauss-Legendre nodes on an arc
_BATCH = 64  # wall points per call, few enough to stay in the cache


def vector_irradiance(
    lens: GlueLens, *, medium_index: ArrayLike, radius: ArrayLike, distance: ArrayLike
) -> tuple[Float[Array, "*batch"], Float[Array, "*batch"]]:
    r"""Vector irradiance V of a lens at wall points, per unit power in the core.

    A wall with inward unit normal **n** receives exactly E = -**n**·**V** if the whole cap is in
    front of it. Light that the cap reflects back into the glue is lost.

    Args:
        lens: the lens.
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
    traced = any(isinstance(leaf, jax.core.Tracer) for leaf in leaves)
    # Whole batches need one compilation for any number of wall points.
    width = min(size, _BATCH) if traced else _BATCH
    wall = jnp.pad(wall, ((0, 0), (0, -size % width)), mode="edge")
    batches = wall.reshape(2, -1, width).transpose(1, 0, 2)

    def evaluate(batch):
        return np.asarray(_batch_field(lens, medium_index, *batch))

    if traced:
        field = lax.map(lambda batch: _batch_field(lens, medium_index, *batch), batches)
    else:
        # One batch is too small for several cores, so each core takes a batch of its own. The first
        # batch runs alone, so that only one thread compiles.
        first, *rest = np.asarray(batches)
        with ThreadPoolExecutor() as pool:
            fields = [evaluate(first), *pool.map(evaluate, rest)]
        field = jnp.asarray(np.stack(fields))
    field = field.transpose(1, 0, 2).reshape(2, -1)[:, :size]
    return field[0].reshape(radius.shape), field[1].reshape(radius.shape)


@jax.jit
def _batch_field(lens, medium_index, radius, distance) -> Float[Array, "2 batch"]:
    return jax.vmap(partial(_field, lens, medium_index), out_axes=1)(radius, distance)


def _field(lens: GlueLens, medium_index, radius, distance) -> Float[Array, "2"]:
    """V at one wall point."""
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

    Args:
        rays: rays by ring and tau.
        ring: the rings.
        openings: places at which an arc can be shorter than the scan's cells.
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
