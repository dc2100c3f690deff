"""Reflexes of a lamp at the surfaces of a viewing path: Purkinje's images."""

from __future__ import annotations

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Bool, Float

from optics import InputError, refract
from optics.viewing.camera import TERMS
from optics.viewing.chebyshev import chebyshev_nodes, series
from optics.viewing.medium import Medium
from optics.viewing.path import ViewingPath
from optics.viewing.trace import SEEN, Element, Iris, Refracting, ThinLens, trace

_START_MM = 20.0
"""Height above the cornea's vertex at which rays start: above every viewing lens."""
_WIDEST_AIM_MM = 14.0
_SCAN = 400
_STEEPEST = 1.0
"""Largest slope of returning light: steeper lines go far past every lamp."""
_SAFE = 0.98  # towards a total reflection the series converge slowly


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
        return series(self.returning, self._argument(aim))[..., None] * aim

    @eqx.filter_jit
    def part(self, aim: Float[ArrayLike, "*batch 2"]) -> Float[Array, "*batch"]:
        """Part of the light that comes back: Fresnel's, there and back; 0 outside the series."""
        aim = jnp.asarray(aim)
        inside = jnp.sum(aim * aim, axis=-1) <= self.widest**2
        return jnp.where(inside, series(self.strength, self._argument(aim)), 0.0)

    def _argument(self, aim: Float[Array, "*batch 2"]) -> Float[Array, "*batch"]:
        return jnp.minimum(2.0 * jnp.sum(aim * aim, axis=-1) / self.widest**2 - 1.0, 1.0)


def reflexes(path: ViewingPath) -> tuple[Reflex, ...]:
    """The reflexes at a path's refracting surfaces, in their order; each line is reflected once.

    Raises:
        InputError: the path's pinhole is at infinity, and so would be the lamp.
    """
    if not path.pinhole_closeness > 0.0:
        raise InputError(
            "reflexes needs a pinhole at a finite height; got a path with pinhole_distance inf. "
            "Give viewing_path(pinhole_distance=...) in mm."
        )
    surfaces = [k for k, element in enumerate(path.elements) if isinstance(element, Refracting)]
    return tuple(_reflex(path, at) for at in surfaces)


@eqx.filter_jit
def _reflex(path: ViewingPath, at: int) -> Reflex:
    step = _WIDEST_AIM_MM / _SCAN
    _, _, returns = _returned(path, at, step * (1.0 + jnp.arange(_SCAN)))
    # 0 if the first line is lost: then no line is shown.
    last = step * jnp.where(jnp.all(returns), _SCAN, jnp.argmin(returns))
    widest = jnp.maximum(_SAFE * last, 1e-3 * step)
    nodes, to_series = chebyshev_nodes(TERMS)
    t = widest * jnp.sqrt((nodes + 1.0) / 2.0)
    place, strength, _ = _returned(path, at, t)
    return Reflex(to_series @ (place / t), to_series @ strength, widest)


def _returned(
    path: ViewingPath, at: int, aim: Float[Array, "n"]
) -> tuple[Float[Array, "n"], Float[Array, "n"], Bool[Array, "n"]]:
    """Distance from the axis in the pinhole's plane, part of the light, and whether it returns."""
    before, mirror = path.elements[:at], path.elements[at]
    assert isinstance(mirror, Refracting)
    across, closeness = jnp.zeros_like(aim), path.pinhole_closeness
    origin = jnp.stack([aim * (1.0 - closeness * _START_MM), across, across - _START_MM], axis=-1)
    direction = jnp.stack([aim * closeness, across, across + 1.0], axis=-1)
    direction = direction / jnp.linalg.norm(direction, axis=-1, keepdims=True)
    there = trace(before, origin, direction)
    medium, front = _last(before)
    point, direction, meets = medium.to_surface(
        there.point, there.direction, mirror.surface, front=front
    )
    normal = mirror.surface.normal(point)
    depth = mirror.surface.depth
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
    place = back.point[:, 0] + slope * (1.0 / closeness - back.point[:, 2])
    part = there.transmittance * (1.0 - passed) * back.transmittance
    returns = meets & (there.status == SEEN) & (back.status == SEEN)
    return place, part, returns & (jnp.abs(slope) < _STEEPEST)


def _last(elements: tuple[Element, ...]) -> tuple[Medium, Float[Array, ""]]:
    """The medium behind elements, and the depth at which it begins; air in front of all."""
    for element in reversed(elements):
        if isinstance(element, Refracting):
            return element.medium, element.surface.depth
    return Medium(1.0), jnp.zeros(())


def _reversed(elements: tuple[Element, ...]) -> tuple[Element, ...]:
    """Elements as light meets them that comes back, with depths that count upwards."""
    found: list[Element] = []
    for number in reversed(range(len(elements))):
        element = elements[number]
        if isinstance(element, Refracting):
            medium, front = _last(elements[:number])
            behind = medium.reversed(element.surface.depth - front)
            found.append(Refracting(element.surface.reversed(), behind))
        elif isinstance(element, ThinLens):
            found.append(ThinLens(depth=-element.depth, power=element.power))
        else:
            found.append(Iris(depth=-element.depth, radius=element.radius))
    return tuple(found)
