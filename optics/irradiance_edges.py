"""Boundaries between lit and dark along a scan, with the implicit function's derivatives.

A point is lit if the excess over all limits is negative (see `BackwardRays`).
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float

_STEPS = 6  # Newton or bisection steps towards a boundary
_APPROACHES = 2  # pairs of steps towards an extremum

Excess = Callable[[Array], Array]


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


def approach_extremes(
    excess: Excess,
    x: Float[Array, "samples *batch"],
    values: Float[Array, "samples *batch"],
    *,
    count: int,
) -> tuple[Float[Array, "samples *batch"], Float[Array, "samples *batch"]]:
    """Move samples to extremes near which a lit or dark stretch is shorter than a cell.

    Where the samples have a positive minimum or a negative maximum, the excess may pass zero twice
    unseen. The sample there is moved to the extremum itself, so no boundary that was seen is lost.

    Args:
        excess: the excess along the scan.
        x: positions of the samples, in order.
        values: their excess.
        count: number of extremes to approach: those that may pass zero farthest.

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

    place = _extremum(excess, pick(x[:-2]), pick(x[2:]), pick(sign))
    at = excess(place)
    closer = pick(sign) * at < pick(here)
    for number, move in enumerate(moves):
        move &= closer[number]
        x = x.at[1:-1].set(jnp.where(move, place[number], x[1:-1]))
        values = values.at[1:-1].set(jnp.where(move, at[number], values[1:-1]))
    return lax.stop_gradient((x, values))


def _extremum(excess: Excess, low: Array, high: Array, sign: Array) -> Array:
    """The minimum of the excess, times a sign, between two positions."""

    def measure(x):
        value, slope = jax.jvp(excess, (x,), (jnp.ones_like(x),))
        return sign * value, sign * slope

    def narrowed(number, state):
        (low, high), (low_value, high_value), (low_slope, high_slope) = state
        steeper = high_slope - low_slope
        # Where the tangents meet is exact if two limits meet, the zero of the slope for a parabola.
        meeting = high_slope * high - low_slope * low + low_value - high_value
        level = high_slope * low - low_slope * high
        x = jnp.where(number % 2 == 0, meeting, level) / jnp.where(steeper == 0.0, 1.0, steeper)
        x = jnp.where((x > low) & (x < high), x, 0.5 * (low + high))
        value, slope = measure(x)
        falls = slope < 0.0

        def chosen(inner, outer):
            return jnp.where(falls, inner, outer[0]), jnp.where(falls, outer[1], inner)

        ends = (low, high), (low_value, high_value), (low_slope, high_slope)
        return tuple(chosen(*pair) for pair in zip((x, value, slope), ends, strict=True))

    # One place in the program for each evaluation, because each of them takes long to compile.
    state = (low, high), *map(tuple, measure(jnp.stack([low, high])))
    (low, high), (low_value, high_value), _ = lax.fori_loop(0, 2 * _APPROACHES, narrowed, state)
    return jnp.where(low_value < high_value, low, high)


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
