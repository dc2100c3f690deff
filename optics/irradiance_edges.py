"""Edges of the part of a cap that is lit when seen from a wall point.

A place is lit where the excess over all limits is negative (see `BackwardRays`).
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
_CROSSINGS = 6  # of the meridian with the lit part's edge: a disc and a ring, both cut through
_MEETING_GRID = 6  # samples each way of the search for a meeting
_STEPS = 6  # Newton or bisection steps towards a boundary

Excess = Callable[[Array], Array]
RingRays = Callable[[Array, Array], BackwardRays]


def ring_breaks(
    lens: GlueLens, rays: RingRays, *, radius: ArrayLike, distance: ArrayLike
) -> Float[Array, "breaks"]:
    """Radii of the cap between which its rings are lit alike, both ends included.

    At a break the lit part's edge crosses the meridian through the wall point or touches a ring, so
    that arcs begin or end, or the cone takes over from the core in bounding them. Breaks carry
    their derivatives: where the core's edge runs along a ring, all of an arc ends with them.

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

    # Samples (nearly) equidistant in the angle seen from the wall point resolve the lit part of one
    # near the cap (small beside the aperture) and of one far away (all of the aperture) alike.
    # At the aperture itself the core's limit can be just reached; the strip beside it may be lit.
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
    # Breaks that are not needed divide the range instead, evenly in the angle again.
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
    # The last step alone is differentiated: it gives the implicit function's derivative.
    place, residual = step(place)
    return residual < 1e-6, inner + (outer - inner) * place[0]


def scan_boundaries(
    x: Float[Array, "samples *batch"], values: Float[Array, "samples *batch"], *, count: int
) -> tuple[Bool[Array, "count *batch"], Array, Array]:
    """Find the first boundaries between lit and dark along a scan.

    Args:
        x: where the samples are, in order.
        values: their excess.
        count: how many boundaries are looked for.

    Returns:
        Whether there are so many, and the samples on the lit and on the dark side of each.
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
    # Not a cumulative sum with a gather: XLA's are thirty times slower here.
    cells = (x[:-1], x[1:], is_lit[:-1], is_lit[1:])
    # A short scan costs less unrolled, a long one takes long to compile that way.
    (passed, lit, dark), _ = lax.scan(visit, start, cells, unroll=len(x) <= 16)
    return passed > number, lit, dark


def settle(excess: Excess, lit: Array, dark: Array) -> Array:
    """Narrow pairs of a lit and a dark place down to the boundary between them.

    Newton steps, and bisection where such a step leaves the pair: the excess has kinks where
    limits take turns.

    Args:
        excess: the excess along the scan.
        lit: places where it is negative.
        dark: places where it is not.

    Returns:
        Places from which one Newton step more leads to the boundary; they carry no derivative.
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
    # On the dark side the limit that is broken first is the largest; on the lit side it need not.
    return jnp.where((x_next - lit) * (x_next - dark) <= 0.0, x, dark)


def implicit_root(excess: Excess, root: Array) -> Array:
    """Take one Newton step more, which also gives roots the implicit function's derivative.

    Args:
        excess: the excess along the scan.
        root: the places found, without derivative.
    """
    value, slope = jax.jvp(excess, (root,), (jnp.ones_like(root),))
    slope = lax.stop_gradient(slope)
    return root - jnp.where(slope == 0.0, 0.0, value / jnp.where(slope == 0.0, 1.0, slope))
