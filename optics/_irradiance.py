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
_RINGS = 4  # Gauss-Legendre nodes between two breaks
_CELLS = 6  # cells of the scan along a ring
_CROSSINGS = 3  # ends of lit arcs on half a ring: two arcs
_ARC = 4  # Gauss-Legendre nodes on an arc
_STEPS = 4  # of false position
_BATCH = 512  # wall points at a time
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
    # Whole batches only, so that two compilations serve every number of wall points.
    width = _BATCH if radius.size > _FEW else _FEW
    wall = jnp.stack([radius.ravel(), distance.ravel()])
    wall = jnp.pad(wall, ((0, 0), (0, -radius.size % width)), mode="edge")
    fields = [
        _batch_field(lens, medium_index, *batch)
        for batch in wall.reshape(2, -1, width).transpose(1, 0, 2)
    ]
    field = jnp.concatenate(fields, axis=1)[:, : radius.size]
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
        first, last = _angle(haversine(first)), _angle(haversine(last))
        half = 0.5 * (last - first)
        light = trace(
            cap_radius=ring, haversine=jnp.square(jnp.sin(0.5 * (first + half * (1.0 + node))))
        )
        # Twice, for the half of the ring on the other side of the meridian's plane.
        area = 2.0 * ring * ring_weight * half * weight
        total = total + jnp.stack([jnp.sum(area * light.lateral), jnp.sum(area * light.axial)])
    return total


def _angle(haversine: Array) -> Array:
    """Angle from its sin²(phi/2), with a zero derivative at the ends 0 and pi."""
    inside = (haversine > 0.0) & (haversine < 1.0)
    angle = 2.0 * jnp.arcsin(jnp.sqrt(jnp.where(inside, haversine, 0.5)))
    return jnp.where(inside, angle, jnp.where(haversine > 0.5, np.pi, 0.0))


def _ring_breaks(lens: GlueLens, excess: _Excess, radius, distance) -> Float[Array, "breaks"]:
    """Radii of the cap at which rings begin or cease to be lit on the meridian, with both ends.

    They only place the quadrature's nodes, so they carry no derivative.
    """
    aperture = jnp.asarray(lens.aperture_radius)
    # Samples equidistant in angle resolve the lit part of a wall point near the cap (small beside
    # the aperture) and of one far away (all of the aperture) alike.
    gap = distance + lens.sagitta(jnp.minimum(radius, 0.999 * aperture))
    first, last = jnp.arctan((-aperture - radius) / gap), jnp.arctan((aperture - radius) / gap)

    def place(angle):
        return jnp.clip(radius + gap * jnp.tan(angle), -aperture, aperture)

    angle = first + (last - first) * np.linspace(0.0, 1.0, _MERIDIAN + 1)
    x = place(angle)
    values = excess(x)
    near = angle[jnp.argmin(values)]
    zoomed = place(near + (last - first) / _MERIDIAN * np.linspace(-1.0, 1.0, _ZOOM + 1))
    found, *bracket = jax.tree.map(
        partial(jnp.where, jnp.any(values < 0.0)),
        _sign_changes(x, values, _BREAKS),
        _sign_changes(zoomed, excess(zoomed), _BREAKS),
    )
    crossing = jnp.abs(_false_position(excess, *bracket))
    inner = jnp.min(jnp.where(found, crossing, aperture))
    outer = jnp.max(jnp.where(found, crossing, 0.0))
    inner, outer = jnp.minimum(inner, outer), jnp.maximum(inner, outer)
    # Breaks that are not needed divide the range evenly instead.
    even = inner + (outer - inner) * np.linspace(0.0, 1.0, _BREAKS)
    breaks = jnp.concatenate([jnp.where(found, crossing, even), jnp.stack([0.0 * gap, aperture])])
    return lax.stop_gradient(jnp.sort(breaks))


def _lit_arcs(excess: _Excess, rings: int) -> list[tuple[Array, Array]]:
    """First and last tau in [0, 1] of the lit arcs of all rings, empty arcs included."""
    tau = jnp.broadcast_to(np.linspace(0.0, 1.0, _CELLS + 1)[:, None], (_CELLS + 1, rings))
    values = lax.stop_gradient(excess(tau))
    found, *bracket = _sign_changes(tau, values, _CROSSINGS)
    root = _polished(excess, _false_position(excess, *bracket))
    ends = [jnp.where(here, end, 1.0) for here, end in zip(found, root, strict=True)]
    from_start = [jnp.zeros(rings), *ends]
    from_first = [*ends, jnp.ones(rings)]
    bounds = [jnp.where(values[0] < 0.0, a, b) for a, b in zip(from_start, from_first, strict=True)]
    return list(zip(bounds[0::2], bounds[1::2], strict=True))


def _sign_changes(
    x: Float[Array, "samples *batch"], values: Float[Array, "samples *batch"], count: int
) -> tuple[Bool[Array, "count *batch"], Array, Array, Array, Array]:
    """The first sign changes of a scan: whether there are so many, x and values on both sides."""
    lit = values < 0.0
    changes = lit[1:] != lit[:-1]
    number = np.arange(1, count + 1).reshape(-1, *(1 for _ in values.shape))
    here = changes & (jnp.cumsum(changes, axis=0) == number)

    def pick(samples):
        return jnp.sum(jnp.where(here, samples, 0.0), axis=1)

    return (jnp.any(here, axis=1), pick(x[:-1]), pick(x[1:]), pick(values[:-1]), pick(values[1:]))


def _false_position(excess: _Excess, low: Array, high: Array, at_low: Array, at_high: Array):
    """Zeros between samples of opposite signs, after Illinois (Dowell & Jarratt, 1971)."""

    def step(_, state):
        low, high, at_low, at_high = state
        rise = at_high - at_low
        middle = high - at_high * (high - low) / jnp.where(rise == 0.0, 1.0, rise)
        value = excess(middle)
        crossed = (value < 0.0) != (at_high < 0.0)
        return (
            jnp.where(crossed, high, low),
            middle,
            jnp.where(crossed, at_high, 0.5 * at_low),
            value,
        )

    state = lax.stop_gradient((low, high, at_low, at_high))
    return lax.stop_gradient(lax.fori_loop(0, _STEPS, step, state)[1])


def _polished(excess: _Excess, root: Array) -> Array:
    """Roots after a Newton step, which also gives them the implicit function's derivative."""
    value, slope = jax.jvp(excess, (root,), (jnp.ones_like(root),))
    slope = lax.stop_gradient(slope)
    step = jnp.where(slope == 0.0, 0.0, value / jnp.where(slope == 0.0, 1.0, slope))
    return jnp.clip(root - step, 0.0, 1.0)
