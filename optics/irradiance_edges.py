"""Edges of the part of a cap that is lit when seen from a wall point.

A point is lit if the excess over all limits is negative (see `BackwardRays`).
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.typing import ArrayLike
from jaxtyping import Array, Bool, Float

from optics.lens import GlueLens
from optics.lens_trace import BackwardRays

_MERIDIAN = 64  # cells of the scan along the meridian
_ZOOM = 16  # cells of the second scan, for a lit part smaller than a cell
_CROSSINGS = 6  # of the meridian with the lit part's edge, for a disc and a ring
_MEETING_GRID = 6  # samples per axis in the search for a meeting
_STEPS = 6  # Newton or bisection steps towards a boundary

Excess = Callable[[Array], Array]
RingRays = Callable[[Array, Array], BackwardRays]


def ring_breaks(
    lens: GlueLens, rays: RingRays, *, radius: ArrayLike, distance: ArrayLike
) -> Float[Array, "breaks"]:
    """Radii of the cap at which the number or the bounds of lit arcs change, with both ends.

    At a break the lit part's edge crosses the meridian through the wall point or touches a ring, so
    that arcs begin or end, or their bound changes between the core and the cone. Breaks have
    derivatives, because a whole arc ends at a break if the core's edge is along a ring.

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
    first = _half_tangent((-aperture - radius) / gap)
    last = _half_tangent((aperture - radius) / gap)

    def place(tangent):
        x = radius + gap * 2.0 * tangent / (1.0 - jnp.square(tangent))
        return jnp.clip(x, -end, end)

    tangent = first + (last - first) * np.linspace(0.0, 1.0, _MERIDIAN + 1)
    x = place(tangent)
    values = excess(x)
    near = tangent[jnp.argmin(values)]
    zoomed = place(near + (last - first) / _MERIDIAN * np.linspace(-1.0, 1.0, _ZOOM + 1))
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
    inner, outer = jnp.minimum(inner, outer), jnp.maximum(inner, outer)
    is_met, meeting = _meetings(rays, inner, outer)
    found, breaks = jnp.append(found, is_met), jnp.append(crossing, meeting)
    # Unused breaks divide the range evenly in the angle.
    first, last = _half_tangent((inner - radius) / gap), _half_tangent((outer - radius) / gap)
    even = place(first + (last - first) * np.linspace(0.0, 1.0, breaks.size))
    breaks = jnp.clip(jnp.where(found, breaks, even), 0.0, aperture)
    zero = jnp.zeros_like(aperture)
    return jnp.sort(jnp.concatenate([breaks, jnp.stack([zero, aperture])]))


def _half_tangent(tangent: Array) -> Array:
    """tan(x/2) from tan(x)."""
    return tangent / (1.0 + jnp.sqrt(1.0 + jnp.square(tangent)))


def _meetings(
    rays: RingRays, inner: Array, outer: Array
) -> tuple[Bool[Array, "3"], Float[Array, "3"]]:
    """Rings on which the cone's edge meets the core's, or touches a ring on either half of it.

    Newton's method in two variables, from the best sample of a grid.
    """
    first, last = np.array([0.0, 0.0, 0.5]), np.array([1.0, 0.5, 1.0])
    meets_core = np.array([True, False, False])

    def values(place):
        def cone(tau):
            light = rays(inner + (outer - inner) * place[0], tau)
            return light.cone, light.face

        (edge, face), (slope, _) = jax.jvp(cone, (place[1],), (jnp.ones_like(place[1]),))
        return edge, jnp.where(meets_core, face, slope)

    def step(place):
        def along(direction):
            move = jnp.broadcast_to(direction[:, None], place.shape)
            return jax.jvp(values, (place,), (move,))

        (a, b), slopes = jax.vmap(along, out_axes=(None, 0))(jnp.eye(2))
        (a_ring, a_tau), (b_ring, b_tau) = lax.stop_gradient(slopes)
        determinant = a_ring * b_tau - a_tau * b_ring
        safe = jnp.where(determinant == 0.0, 1.0, determinant)
        correction = jnp.stack([b_tau * a - a_tau * b, a_ring * b - b_ring * a]) / safe
        return jnp.clip(place - correction, 0.0, 1.0), jnp.maximum(jnp.abs(a), jnp.abs(b))

    share = (np.arange(_MEETING_GRID) + 0.5) / _MEETING_GRID
    ring, tau = np.meshgrid(share, share)
    ring, tau = ring.reshape(-1, 1), first + (last - first) * tau.reshape(-1, 1)
    start = jnp.stack(jnp.broadcast_arrays(ring, tau))
    best = jnp.argmin(jnp.maximum(*map(jnp.abs, values(start))), axis=0)
    place = lax.stop_gradient(jnp.stack([start[0, :, 0][best], start[1, best, np.arange(3)]]))
    place = lax.stop_gradient(lax.fori_loop(0, _STEPS, lambda _, place: step(place)[0], place))
    # Only the last step is differentiated; it gives the implicit function's derivative.
    place, residual = step(place)
    return residual < 1e-6, inner + (outer - inner) * place[0]


def scan_boundaries(
    x: Float[Array, "samples *batch"], values: Float[Array, "samples *batch"], *, count: int
) -> tuple[Bool[Array, "count *batch"], Array, Array]:
    """Find the first boundaries between lit and dark along a scan.

    Args:
        x: positions of the samples, in order.
        values: their excess.
        count: number of boundaries to find.

    Returns:
        Whether each boundary exists, and the samples on its lit and on its dark side.
    """
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
    # A cumulative sum with a gather would be thirty times slower in XLA.
    cells = (x[:-1], x[1:], is_lit[:-1], is_lit[1:])
    # A short scan costs less unrolled, a long one takes long to compile that way.
    (passed, lit, dark), _ = lax.scan(visit, start, cells, unroll=len(x) <= 16)
    return passed > number, lit, dark


def settle(excess: Excess, lit: Array, dark: Array) -> Array:
    """Find the boundary between each pair of a lit and a dark position.

    Newton steps, with bisection if a step leaves the pair, because the excess has kinks where
    another limit becomes the largest.

    Args:
        excess: the excess along the scan.
        lit: positions where it is negative.
        dark: positions where it is not.

    Returns:
        Positions from which one more Newton step leads to the boundary, without derivatives.
    """

    def measure(x):
        return jax.jvp(excess, (x,), (jnp.ones_like(x),))

    def newton(x, value, slope):
        return jnp.where(slope == 0.0, jnp.inf, x - value / jnp.where(slope == 0.0, 1.0, slope))

    def step(_, state):
        lit, dark, x, value, slope = state
        x_next = newton(x, value, slope)
        x = jnp.where((x_next - lit) * (x_next - dark) <= 0.0, x_next, 0.5 * (lit + dark))
        value, slope = measure(x)
        is_lit = value < 0.0
        return jnp.where(is_lit, x, lit), jnp.where(is_lit, dark, x), x, value, slope

    lit, dark = lax.stop_gradient((lit, dark))
    # Without a slope the first step bisects.
    unknown = jnp.zeros_like(dark)
    state = lax.fori_loop(0, _STEPS + 1, step, (lit, dark, dark, unknown, unknown))
    lit, dark, x, value, slope = lax.stop_gradient(state)
    x_next = newton(x, value, slope)
    # On the dark side the limit that bounds the light is the largest; on the lit side maybe not.
    return jnp.where((x_next - lit) * (x_next - dark) <= 0.0, x, dark)


def implicit_root(excess: Excess, root: Array) -> Array:
    """Take one more Newton step, which gives roots the implicit function's derivative.

    Args:
        excess: the excess along the scan.
        root: the positions found, without derivatives.
    """
    value, slope = jax.jvp(excess, (root,), (jnp.ones_like(root),))
    slope = lax.stop_gradient(slope)
    return root - jnp.where(slope == 0.0, 0.0, value / jnp.where(slope == 0.0, 1.0, slope))
