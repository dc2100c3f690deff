r"""Vector irradiance of a glue lens on any wall point, by deterministic quadrature.

$\mathbf V(X) = \int L\,\boldsymbol\omega\,d\omega$ over the part of the cap that is lit when seen
from X, with $L = L_0\,T\,(n_0/n_g)^2$: radiance is conserved along a ray but for $n^2$ and the
Fresnel loss. The lit part is bounded by the cone, the core and the rim; spherical aberration makes
crescents and rings of it. The quadrature runs over rings of the cap about the axis, and on each
over its lit arcs, whose ends are found by root finding: the integrand is smooth, and derivatives
include what the moving ends add.
"""

from collections.abc import Callable
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.typing import ArrayLike
from jaxtyping import Array, Bool, Float

from optics._lens import GlueLens
from optics._lens_trace import trace_backwards

_MERIDIAN = 64  # cells of the scan along the meridian
_ZOOM = 16  # cells of the second scan, for a lit part smaller than a cell
_BREAKS = 6  # radii between which rings are lit alike: a disc and a ring, both cut through
_RINGS = 6  # Gauss-Legendre nodes between two breaks
_CELLS = 6  # cells of the scan along a ring
_CROSSINGS = 2  # ends of lit arcs on half a ring
_ARC = 4  # Gauss-Legendre nodes on an arc
_STEPS = 6  # towards a boundary
_BATCH = 256  # wall points at a time: what they need stays in the cache
_FEW = 16

_Excess = Callable[[Array], Array]


def vector_irradiance(
    lens: GlueLens, *, medium_index: ArrayLike, radius: ArrayLike, distance: ArrayLike
) -> tuple[Float[Array, "*batch"], Float[Array, "*batch"]]:
    r"""Vector irradiance V of a lens at wall points, per unit power in the core.

    A matt wall with inward unit normal **n** receives E = -**n**·**V**, exactly, while the whole
    cap is in front of it. Interreflections inside the glue are left out: light counts if it
    passes the cap at its first try.

    Args:
        lens: the lens.
        medium_index: n0, refractive index of the medium.
        radius: distance of the wall point from the axis, mm.
        distance: s, distance of the wall point from the tip along the axis, mm, positive.

    Returns:
        V_rho and V_s, 1/mm². Both are 0 outside the light.
    """
    radius, distance = jnp.broadcast_arrays(
        jnp.asarray(radius, dtype=float), jnp.asarray(distance, dtype=float)
    )
    medium_index = jnp.asarray(medium_index, dtype=float)
    size = radius.size
    wall = jnp.stack([radius.ravel(), distance.ravel()])
    traced = any(isinstance(x, jax.core.Tracer) for x in jax.tree.leaves((lens, medium_index, wall)))
    # Known wall points come in whole batches, so that two compilations serve every number of them.
    width = min(size, _BATCH) if traced else (_BATCH if size > _FEW else _FEW)
    wall = jnp.pad(wall, ((0, 0), (0, -size % width)), mode="edge")
    batches = wall.reshape(2, -1, width).transpose(1, 0, 2)
    if traced:
        field = lax.map(lambda batch: _batch_field(lens, medium_index, *batch), batches)
    else:
        pending = [_batch_field(lens, medium_index, *batch) for batch in np.asarray(batches)]
        field = jnp.asarray(np.stack(pending))
    field = field.transpose(1, 0, 2).reshape(2, -1)[:, :size]
    return field[0].reshape(radius.shape), field[1].reshape(radius.shape)


@jax.jit
def _batch_field(lens, medium_index, radius, distance) -> Float[Array, "2 batch"]:
    return jax.vmap(partial(_field, lens, medium_index), out_axes=1)(radius, distance)


def _field(lens: GlueLens, medium_index, radius, distance) -> Float[Array, "2"]:
    """V at one wall point."""
    trace = partial(
        trace_backwards, lens, medium_index=medium_index, radius=radius, distance=distance
    )
    breaks = _ring_breaks(
        lens,
        lambda x: trace(cap_radius=jnp.abs(x), haversine=jnp.where(x < 0.0, 1.0, 0.0)).excess,
        radius,
        distance,
    )
    node, weight = np.polynomial.legendre.leggauss(_RINGS)
    # An arc opens and closes like a square root at a break; the cosine makes that smooth.
    turn = 0.5 * np.pi * (node + 1.0)
    share, share_weight = 0.5 - 0.5 * np.cos(turn), 0.25 * np.pi * np.sin(turn) * weight
    start, width = breaks[:-1, None], jnp.diff(breaks)[:, None]
    ring, ring_weight = (start + width * share).ravel(), (width * share_weight).ravel()

    # Along a ring the squared sine at the wall point is linear in the Möbius map below of
    # sin²(phi/2), for wall points near the cap and far from it: few steps find a root.
    gap_squared = jnp.square(radius - ring) + jnp.square(distance + lens.sagitta(ring))
    swing = 4.0 * radius * ring / gap_squared

    def haversine(tau):
        return tau / (1.0 + swing * (1.0 - tau))

    def excess(tau):
        return trace(cap_radius=ring, haversine=haversine(tau)).excess

    node, weight = np.polynomial.legendre.leggauss(_ARC)
    node, weight = node[:, None], weight[:, None]
    total = jnp.zeros(2)
    for first, last in _lit_arcs(excess, ring.size):
        first, last = _quarter_tangent(haversine(first)), _quarter_tangent(haversine(last))
        half = 0.5 * (last - first)
        tangent = first + half * (1.0 + node)
        stretch = 1.0 + jnp.square(tangent)
        light = trace(cap_radius=ring, haversine=jnp.square(2.0 * tangent / stretch))
        # Twice, for the half of the ring on the other side of the meridian's plane.
        area = 2.0 * ring * ring_weight * (4.0 * half / stretch) * weight
        total = total + jnp.stack([jnp.sum(area * light.lateral), jnp.sum(area * light.axial)])
    return total


def _quarter_tangent(haversine: Array) -> Array:
    """tan(phi/4) from sin²(phi/2), with a zero derivative at the ends 0 and pi.

    As a variable of integration it is as smooth as phi, and needs no sines, which are slow.
    """
    inside = (haversine > 0.0) & (haversine < 1.0)
    safe = jnp.where(inside, haversine, 0.5)
    tangent = jnp.sqrt(safe) / (1.0 + jnp.sqrt(1.0 - safe))
    return jnp.where(inside, tangent, jnp.where(haversine > 0.5, 1.0, 0.0))


def _ring_breaks(lens: GlueLens, excess: _Excess, radius, distance) -> Float[Array, "breaks"]:
    """Radii of the cap at which rings begin or cease to be lit on the meridian, with both ends.

    They only place the quadrature's nodes, so they carry no derivative.
    """
    aperture = jnp.asarray(lens.aperture_radius)
    # Samples (nearly) equidistant in the angle seen from the wall point resolve the lit part of one
    # near the cap (small beside the aperture) and of one far away (all of the aperture) alike.
    gap = distance + lens.sagitta(jnp.minimum(radius, 0.999 * aperture))
    first, last = _half_tangent((-aperture - radius) / gap), _half_tangent((aperture - radius) / gap)

    def place(tangent):
        x = radius + gap * 2.0 * tangent / (1.0 - jnp.square(tangent))
        return jnp.clip(x, -aperture, aperture)

    tangent = first + (last - first) * np.linspace(0.0, 1.0, _MERIDIAN + 1)
    x = place(tangent)
    values = excess(x)
    near = tangent[jnp.argmin(values)]
    zoomed = place(near + (last - first) / _MERIDIAN * np.linspace(-1.0, 1.0, _ZOOM + 1))
    found, lit, dark = jax.tree.map(
        partial(jnp.where, jnp.any(values < 0.0)),
        _boundaries(x, values, _BREAKS),
        _boundaries(zoomed, excess(zoomed), _BREAKS),
    )
    crossing = _dark_side(excess, lit, dark)
    crossing = jnp.abs(_implicit(excess, crossing, low=-aperture, high=aperture))
    inner = jnp.min(jnp.where(found, crossing, aperture))
    outer = jnp.max(jnp.where(found, crossing, 0.0))
    inner, outer = jnp.minimum(inner, outer), jnp.maximum(inner, outer)
    # Breaks that are not needed divide the range evenly instead.
    even = inner + (outer - inner) * np.linspace(0.0, 1.0, _BREAKS)
    breaks = jnp.concatenate([jnp.where(found, crossing, even), jnp.stack([0.0 * gap, aperture])])
    return lax.stop_gradient(jnp.sort(breaks))


def _half_tangent(tangent: Array) -> Array:
    """tan(x/2) from tan(x)."""
    return tangent / (1.0 + jnp.sqrt(1.0 + jnp.square(tangent)))


def _lit_arcs(excess: _Excess, rings: int) -> list[tuple[Array, Array]]:
    """First and last tau in [0, 1] of the lit arcs of all rings, empty arcs included."""
    tau = jnp.broadcast_to(np.linspace(0.0, 1.0, _CELLS + 1)[:, None], (_CELLS + 1, rings))
    values = excess(tau)
    found, lit, dark = _boundaries(tau, values, _CROSSINGS)
    root = _implicit(excess, _dark_side(excess, lit, dark), low=0.0, high=1.0)
    zero, one = jnp.zeros(rings), jnp.ones(rings)
    end, other = jnp.where(found, root, one)
    starts_lit = values[0] < 0.0
    first_arc = jnp.where(starts_lit, zero, end), jnp.where(starts_lit, end, other)
    second_arc = jnp.where(starts_lit, other, one), one
    return [first_arc, second_arc]


def _boundaries(
    x: Float[Array, "samples *batch"], values: Float[Array, "samples *batch"], count: int
) -> tuple[Bool[Array, "count *batch"], Array, Array]:
    """The first boundaries along a scan: whether there are so many, lit and dark neighbours."""
    number = np.arange(count).reshape(-1, *(1 for _ in values.shape[1:]))

    def visit(state, cell):
        passed, lit, dark = state
        left, right, left_lit, right_lit = cell
        changes = left_lit != right_lit
        here = changes & (passed == number)
        return (
            passed + changes,
            jnp.where(here, jnp.where(left_lit, left, right), lit),
            jnp.where(here, jnp.where(left_lit, right, left), dark),
        ), None

    is_lit = values < 0.0
    nowhere = jnp.zeros((count, *values.shape[1:]))
    start = (jnp.zeros(values.shape[1:], dtype=int), nowhere, nowhere)
    # Not a cumulative sum with a gather: XLA's are thirty times slower here.
    cells = (x[:-1], x[1:], is_lit[:-1], is_lit[1:])
    (passed, lit, dark), _ = lax.scan(visit, start, cells, unroll=8)
    return passed > number, lit, dark


def _dark_side(excess: _Excess, lit: Array, dark: Array) -> Array:
    """Place near the boundary between a lit and a dark place, on its dark side.

    Newton steps from the dark side, where the limit that is broken first is the largest, and
    bisection where such a step leaves the pair: the excess has kinks where limits take turns.
    """

    def measure(x):
        return jax.jvp(excess, (x,), (jnp.ones_like(x),))

    def step(_, state):
        lit, dark, value, slope = state
        newton = dark - value / jnp.where(slope == 0.0, 1.0, slope)
        within = (newton - lit) * (newton - dark) < 0.0
        x = jnp.where(within, newton, 0.5 * (lit + dark))
        at_x, slope_at_x = measure(x)
        is_lit = at_x < 0.0
        return (
            jnp.where(is_lit, x, lit),
            jnp.where(is_lit, dark, x),
            jnp.where(is_lit, value, at_x),
            jnp.where(is_lit, slope, slope_at_x),
        )

    lit, dark = lax.stop_gradient((lit, dark))
    return lax.stop_gradient(lax.fori_loop(0, _STEPS, step, (lit, dark, *measure(dark)))[1])


def _implicit(excess: _Excess, root: Array, *, low: ArrayLike, high: ArrayLike) -> Array:
    """Roots after a Newton step, which also gives them the implicit function's derivative."""
    value, slope = jax.jvp(excess, (root,), (jnp.ones_like(root),))
    slope = lax.stop_gradient(slope)
    step = jnp.where(slope == 0.0, 0.0, value / jnp.where(slope == 0.0, 1.0, slope))
    return jnp.clip(root - step, low, high)
