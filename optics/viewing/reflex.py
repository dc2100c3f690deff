"""Reflexes of a lamp at the surfaces of a viewing path, Purkinje's images."""

from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Bool, Float

from eyespot.optics import refract
from eyespot.optics.viewing.path import (
    SCANNED_MM,
    ViewingPath,
    before_path,
    check_finite,
    last_medium,
    radial_nodes,
    radial_place,
    series,
)
from eyespot.optics.viewing.trace import SEEN, Element, Refracting, trace

_STEEPEST = 1.0
"""Largest slope of returning light: steeper lines go far past every lamp."""
_SAFE_SLOPE = 0.98  # towards a total reflection the series converge slowly


class Reflex(eqx.Module):
    """Where lines of sight end in the pinhole's plane if one surface reflects them.

    A line that aims at a distance t from the axis returns to a distance t m(t²) from it. A pixel
    shows the lamp if the lamp covers the place to which its line returns.

    Attributes:
        returning: Chebyshev coefficients of m.
        strength: Chebyshev coefficients of the part of the light that comes back.
        widest: largest t of the series, mm; up to it the iris stops no line.
    """

    returning: Float[Array, "terms"]
    strength: Float[Array, "terms"]
    widest: Float[Array, ""]

    @eqx.filter_jit
    def place(self, aim: Float[ArrayLike, "*batch 2"]) -> Float[Array, "*batch 2"]:
        """X and Y to which lines of sight return in the pinhole's plane, mm."""
        aim = jnp.asarray(aim)
        place = radial_place(jnp.sum(aim * aim, axis=-1), self.widest)
        return series(self.returning, place)[..., None] * aim

    @eqx.filter_jit
    def part(self, aim: Float[ArrayLike, "*batch 2"]) -> Float[Array, "*batch"]:
        """Part of the light that comes back: Fresnel's, there and back; 0 outside the series."""
        t2 = jnp.sum(jnp.square(jnp.asarray(aim)), axis=-1)
        strength = series(self.strength, radial_place(t2, self.widest))
        return jnp.where(t2 <= self.widest**2, strength, 0.0)


def reflexes(path: ViewingPath) -> tuple[Reflex, ...]:
    """The reflexes at a path's refracting surfaces, in their order; each line is reflected once.

    Raises:
        InputError: the path's pinhole is at infinity, and so would be the lamp.
    """
    check_finite(path, "reflexes")
    surfaces = [k for k, element in enumerate(path.elements) if isinstance(element, Refracting)]
    return tuple(_reflex(path, at) for at in surfaces)


@eqx.filter_jit
def _reflex(path: ViewingPath, at: int) -> Reflex:
    _, _, returns = _returned(path, at, jnp.asarray(SCANNED_MM))
    step = SCANNED_MM[0]
    # 0 if the first line is lost: then no line is shown.
    last = step * jnp.where(jnp.all(returns), SCANNED_MM.size, jnp.argmin(returns))
    widest = jnp.maximum(_SAFE_SLOPE * last, 1e-3 * step)
    t, to_series = radial_nodes(widest)
    place, strength, _ = _returned(path, at, t)
    return Reflex(to_series @ (place / t), to_series @ strength, widest)


def _returned(
    path: ViewingPath, at: int, aim: Float[Array, "n"]
) -> tuple[Float[Array, "n"], Float[Array, "n"], Bool[Array, "n"]]:
    """Distance from the axis in the pinhole's plane, part of the light, and whether it returns."""
    before, mirror = path.elements[:at], path.elements[at]
    assert isinstance(mirror, Refracting)
    meridional = jnp.stack([aim, jnp.zeros_like(aim)], axis=-1)
    there = trace(before, *before_path(path, meridional, path.pinhole_closeness * meridional))
    medium, front = last_medium(before)
    point, direction, meets = medium.to_surface(
        there.point, there.direction, mirror.surface, front=front
    )
    normal = mirror.surface.normal(point)
    depth = mirror.depth
    _, passed, _ = refract(
        direction=direction,
        normal=normal,
        index_incident=medium.index_at(point, front=front),
        index_transmitted=mirror.medium.index_at(point, front=depth),
    )
    direction = direction - 2.0 * jnp.sum(direction * normal, axis=-1)[..., None] * normal
    # Seen upside down, the light goes on through the same elements in reversed order.
    upwards = jnp.array([1.0, 1.0, -1.0])
    back = trace(
        _reversed(before),
        upwards * point,
        upwards * direction,
        medium=medium.reversed(depth - front),
        front=-depth,
    )
    slope = back.direction[:, 0] / back.direction[:, 2]
    place = back.point[:, 0] + slope * (1.0 / path.pinhole_closeness - back.point[:, 2])
    part = there.transmittance * (1.0 - passed) * back.transmittance
    returns = meets & (there.status == SEEN) & (back.status == SEEN)
    return place, part, returns & (jnp.abs(slope) < _STEEPEST)


def _reversed(elements: tuple[Element, ...]) -> tuple[Element, ...]:
    """Elements as light meets them that comes back, with depths that count upwards."""
    found: list[Element] = []
    for number in reversed(range(len(elements))):
        element = elements[number]
        if isinstance(element, Refracting):
            medium, front = last_medium(elements[:number])
            behind = medium.reversed(element.depth - front)
            found.append(Refracting(element.surface.reversed(), behind))
        else:
            found.append(replace(element, depth=-element.depth))
    return tuple(found)
