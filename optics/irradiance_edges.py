"""The edge of a cap's lit part, when seen from a wall point.

Rays are traced backwards from the wall point through the cap of a glue lens to the core's face. A
point of the cap is lit if the excess over all limits is negative (see `BackwardRays`). Boundaries
between lit and dark are found along a scan, with the implicit function's derivatives. The edge
turns on rings that it touches, or on which two limits meet.
"""

from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float

from eyespot.optics.lens import GlueLens
from eyespot.optics.refraction import fresnel_transmittance, refracted_cosine

_STEPS = 6  # Newton or bisection steps towards a boundary
_APPROACHES = 2  # pairs of steps towards an extremum

Excess = Callable[[Array], Array]
"""The excess at positions along a scan."""


def scan_boundaries(
    x: Float[Array, "samples *batch"], values: Float[Array, "samples *batch"], *, count: int
) -> tuple[Bool[Array, "count *batch"], Array, Array]:
    """Find the first `count` boundaries between lit and dark along a scan of ordered samples.

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


def approach_extremes(
    excess: Excess,
    x: Float[Array, "samples *batch"],
    values: Float[Array, "samples *batch"],
    *,
    count: int,
) -> tuple[Float[Array, "samples *batch"], Float[Array, "samples *batch"]]:
    """Move ordered samples to extremes near which a lit or dark stretch is shorter than a cell.

    Where the samples have a positive minimum or a negative maximum, the excess may pass zero twice
    unseen. The sample there is moved to the extremum itself, so no boundary that was seen is lost.
    The `count` extremes that may pass zero farthest are approached.

    Returns:
        Positions and values of all samples, without derivatives.
    """
    x, values = lax.stop_gradient((x, values))
    inner = np.arange(1, len(x) - 1).reshape(-1, *(1 for _ in values.shape[1:]))
    sign = jnp.where(values[1:-1] < 0.0, -1.0, 1.0)
    here, before, after = (sign * v for v in (values[1:-1], values[:-2], values[2:]))
    reach = jnp.where(
        (here <= before) & (here < after), here - 0.5 * jnp.maximum(before, after), jnp.inf
    )
    moves = []
    for _ in range(count):
        moves.append((inner == 1 + jnp.argmin(reach, axis=0)) & (reach < 0.0))
        reach = jnp.where(moves[-1], jnp.inf, reach)

    def pick(of_samples):
        # A gather would be slow in XLA.
        return jnp.stack([jnp.sum(jnp.where(move, of_samples, 0.0), axis=0) for move in moves])

    sign = pick(sign)
    place, lowest = _extremum(excess, pick(x[:-2]), pick(x[2:]), sign)
    closer, at = lowest < pick(here), sign * lowest
    for number, move in enumerate(moves):
        move &= closer[number]
        x = x.at[1:-1].set(jnp.where(move, place[number], x[1:-1]))
        values = values.at[1:-1].set(jnp.where(move, at[number], values[1:-1]))
    return lax.stop_gradient((x, values))


def _extremum(excess: Excess, low: Array, high: Array, sign: Array) -> tuple[Array, Array]:
    """Place and value of the minimum of the excess, times a sign, between two positions."""

    def narrowed(number, state):
        (low, high), (low_value, high_value), (low_slope, high_slope) = state
        steeper = high_slope - low_slope
        # Where the tangents meet is exact if two limits meet, the zero of the slope for a parabola.
        meeting = high_slope * high - low_slope * low + low_value - high_value
        level = high_slope * low - low_slope * high
        x = jnp.where(number % 2 == 0, meeting, level) / _nonzero(steeper)
        x = jnp.where((x > low) & (x < high), x, 0.5 * (low + high))
        # The first two steps measure the ends: a second place in the program for the evaluation
        # would take as long to compile as the first.
        x = jnp.where(number == 0, low, jnp.where(number == 1, high, x))
        value, slope = (sign * y for y in jax.jvp(excess, (x,), (jnp.ones_like(x),)))
        falls = jnp.where(number < 2, number == 0, slope < 0.0)

        def chosen(inner, outer):
            return jnp.where(falls, inner, outer[0]), jnp.where(falls, outer[1], inner)

        ends = (low, high), (low_value, high_value), (low_slope, high_slope)
        return tuple(chosen(*pair) for pair in zip((x, value, slope), ends, strict=True))

    unknown = jnp.zeros_like(low), jnp.zeros_like(high)
    state = (low, high), unknown, unknown
    (low, high), (low_value, high_value), _ = lax.fori_loop(0, 2 + 2 * _APPROACHES, narrowed, state)
    is_low = low_value < high_value
    return jnp.where(is_low, low, high), jnp.where(is_low, low_value, high_value)


def settle(excess: Excess, lit: Array, dark: Array) -> Array:
    """Find the boundary between each pair of a lit and a dark position.

    Newton steps, with bisection if a step leaves the pair, because the excess has kinks where
    another limit becomes the largest.

    Returns:
        Positions from which one more Newton step leads to the boundary, without derivatives.
    """

    def newton(x, value, slope):
        return jnp.where(slope == 0.0, jnp.inf, x - value / _nonzero(slope))

    def step(_, state):
        lit, dark, x, value, slope = state
        x_next = newton(x, value, slope)
        x = jnp.where((x_next - lit) * (x_next - dark) <= 0.0, x_next, 0.5 * (lit + dark))
        value, slope = jax.jvp(excess, (x,), (jnp.ones_like(x),))
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
    """Take one more Newton step, which gives roots the implicit function's derivative."""
    value, slope = jax.jvp(excess, (root,), (jnp.ones_like(root),))
    slope = lax.stop_gradient(slope)
    return root - jnp.where(slope == 0.0, 0.0, value / _nonzero(slope))


class BackwardRays(NamedTuple):
    """Light that reaches a wall point through points of the cap.

    Light arrives only within four limits. Each is given as an excess that is negative within it.

    Attributes:
        cone: sin² of the angle to the axis inside the glue over that of the numerical aperture,
            minus 1.
        face: squared radius at which the ray starts over that of the face's lit part, minus 1.
        drop: the larger of two excesses: the squared radius at which the ray passes the rim's plane
            over the aperture's, minus 1, and minus the cosine between the cap's normal and the
            direction to the wall point.
        lateral: dV_rho per area of the aperture's plane, without the limits, 1/mm⁴.
        axial: dV_s per area of the aperture's plane, without the limits, 1/mm⁴.
    """

    cone: Float[Array, "*batch"]
    face: Float[Array, "*batch"]
    drop: Float[Array, "*batch"]
    lateral: Float[Array, "*batch"]
    axial: Float[Array, "*batch"]

    @property
    def excess(self) -> Float[Array, "*batch"]:
        """Largest excess: negative where light arrives."""
        return jnp.maximum(jnp.maximum(self.cone, self.face), self.drop)


_RINGS, _TURNS = 16, 10  # cells of the search for turns of the edge
_STARTS = 4  # starts of the search for each kind of turn
_NEWTON_STEPS, _LONGEST = 7, 0.25  # Newton steps towards a turn, and their bound
_SCAN_MARGIN = 0.5  # part of the lit range that is added to it, because its bounds are estimates
_TURN_TOLERANCE = 1e-6  # residual of a turn

# A turn is a zero of one limit and of its slope along the ring (touches), or of two limits.
# Limits: 0 cone, 1 face, 2 drop.
_FIRST, _SECOND = np.array([0, 0, 1, 0, 1, 2]), np.array([1, 2, 2, 0, 1, 2])
_TOUCHES = _FIRST == _SECOND


class RingRays(eqx.Module):
    """Rays from a wall point backwards through points of half a ring of the cap.

    A search for a boundary needs no derivatives: it uses `lax.stop_gradient` of this object, since
    to differentiate its steps only to discard the result takes most of the time of compilation.

    Attributes:
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

    def trace(self, cap_radius: Array, haversine: Array) -> BackwardRays:
        """Trace from the wall point through points of the cap to the core's face.

        Args:
            cap_radius: distance of the cap point from the axis, mm, within the aperture.
            haversine: sin²(φ/2) of the angle φ around the axis from the wall point to the cap
                point. Unlike cos φ it stays accurate for small angles.
        """
        lens, radius = self.lens, self.radius
        ratio = self.medium_index / lens.glue_index
        curvature = lens.curvature
        # A hemisphere's rim has a normal perpendicular to the axis; the bound avoids infinities.
        normal_s = jnp.sqrt(jnp.maximum(1.0 - jnp.square(curvature * cap_radius), 1e-12))
        depth = curvature * jnp.square(cap_radius) / (1.0 + normal_s)

        # In the plane perpendicular to the axis, components are along the cap point's radial unit
        # vector and perpendicular to it.
        cos, sin_squared = 1.0 - 2.0 * haversine, 4.0 * haversine * (1.0 - haversine)
        out_radial = radius * cos - cap_radius
        out_across_squared = jnp.square(radius) * sin_squared
        out_s = self.distance + depth
        length_squared = (
            jnp.square(radius - cap_radius)
            + 4.0 * radius * cap_radius * haversine
            + jnp.square(out_s)
        )
        per_length = 1.0 / jnp.sqrt(length_squared)
        out_radial, out_s = out_radial * per_length, out_s * per_length
        cos_medium = out_radial * curvature * cap_radius + out_s * normal_s
        cos_glue = refracted_cosine(cos_incident=cos_medium, index_ratio=ratio)
        bend = cos_glue - ratio * cos_medium
        in_radial = ratio * out_radial + bend * curvature * cap_radius
        in_s = ratio * out_s + bend * normal_s
        in_across_squared = jnp.square(ratio * per_length) * out_across_squared

        sine_squared = jnp.square(in_radial) + in_across_squared
        # Rays back towards the medium are outside every cone; 2 - sin² continues to increase there.
        opening = jnp.where(in_s > 0.0, sine_squared, 2.0 - sine_squared)
        per_forward = 1.0 / jnp.maximum(in_s, 1e-3)

        def crossing_squared(path):
            return jnp.square(cap_radius - path * in_radial) + jnp.square(path) * in_across_squared

        face_squared = crossing_squared((lens.glue_length - depth) * per_forward)
        rim_squared = crossing_squared((lens.sag - depth) * per_forward)
        # A ray from behind the cap carries nothing; Fresnel's formula has no negative cosines.
        facing = jnp.maximum(cos_medium, 0.0)
        transmittance = fresnel_transmittance(
            cos_incident=facing,
            cos_transmitted=cos_glue,
            index_incident=self.medium_index,
            index_transmitted=lens.glue_index,
        )
        radiance = lens.radiance(face_radius_squared=face_squared, sine_squared=sine_squared)
        per_area = (
            radiance * transmittance * jnp.square(ratio) * facing / (normal_s * length_squared)
        )
        out_meridian = (radius - cap_radius * cos) * per_length
        return BackwardRays(
            cone=opening / jnp.square(lens.sine_limit) - 1.0,
            face=face_squared / jnp.square(lens.face_radius) - 1.0,
            drop=jnp.maximum(rim_squared / jnp.square(lens.aperture_radius) - 1.0, -cos_medium),
            lateral=per_area * out_meridian,
            axial=per_area * out_s,
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

    def between(self, first: Array, last: Array) -> "RingRange":
        """The range between two rings."""
        ends = self.angle(first), self.angle(last)
        return RingRange(self.radius, self.gap, self.end, *ends)


def find_turns(
    rays: RingRays, ring_at: RingRange
) -> tuple[Bool[Array, "turns"], Array, Array, Array]:
    """Rings that the lit part's edge touches, and rings on which two limits meet on it.

    Newton's method in two variables, from the cells of a grid on the range that may be lit.

    Returns:
        Whether each candidate is one, its ring, its tau, and the drift of the arc that opens there.
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
        return jnp.stack([value[first_limit, which], other]), jnp.max(value, axis=0)

    def moved(place, both, slopes):
        """A Newton step from two functions and their slopes by ring and tau."""
        (a, b), ((a_ring, b_ring), (a_tau, b_tau)) = both, slopes
        correction = jnp.stack([b_tau * a - a_tau * b, a_ring * b - b_ring * a])
        correction /= _nonzero(a_ring * b_tau - a_tau * b_ring)
        ring, tau = place - jnp.clip(correction, -_LONGEST, _LONGEST)
        return jnp.stack(
            [jnp.clip(ring, -_SCAN_MARGIN, 1.0 + _SCAN_MARGIN), jnp.clip(tau, 0.0, 1.0)]
        )

    def step(_, state):
        place = state[0]

        def along(direction):
            move = jnp.broadcast_to(direction[:, None], place.shape)
            return jax.jvp(lambda place: values(place, *still), (place,), (move,))

        (both, excess), (slopes, _) = jax.vmap(along, out_axes=(None, 0))(jnp.eye(2))
        is_turn = jnp.maximum(jnp.max(jnp.abs(both), axis=0), excess) < _TURN_TOLERANCE
        return moved(place, both, slopes), place, slopes, is_turn

    place = lax.stop_gradient(place)
    start = place, place, jnp.zeros((2, *place.shape)), jnp.zeros(place.shape[1], bool)
    _, place, slopes, is_turn = lax.stop_gradient(lax.fori_loop(0, _NEWTON_STEPS + 1, step, start))
    # Only the values of the last step are differentiated; that gives the implicit function's
    # derivative.
    last = moved(place, values(place, rays, ring_at)[0], slopes)
    # Next to a touched ring the short arc lies around the zero of the slope, and next to a meeting
    # of two limits between their zeros.
    (a_ring, b_ring), (a_tau, b_tau) = slopes
    second = -b_ring / _nonzero(b_tau)
    drift = jnp.where(touches, second, 0.5 * (second - a_ring / _nonzero(a_tau)))
    ring, per_share = jax.jvp(ring_at, (last[0],), (jnp.ones_like(last[0]),))
    return is_turn, ring, *lax.stop_gradient((last[1], drift / _nonzero(per_share)))


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
