"""Rays traced from the microscope through the surfaces of a viewing path into the eye."""

from __future__ import annotations

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float, Int, ScalarLike

from optics import components, refract
from optics.viewing.conic import Conic
from optics.viewing.medium import Medium

SEEN, VIGNETTED, REFLECTED, MISSED = 0, 1, 2, 3
"""Status of a line of sight: it reaches the eye's inside, the iris stops it, a surface reflects it
totally, or it misses a surface."""


class Refracting(eqx.Module):
    """A surface, and the medium behind it.

    Attributes:
        surface: the boundary.
        medium: the medium on its far side, seen from the microscope.
    """

    surface: Conic
    medium: Medium


class ThinLens(eqx.Module):
    """An ideal thin lens in air: it takes power times height off a ray's slope.

    Attributes:
        depth: zeta, mm below the cornea's vertex; negative above it.
        power: 1/f, 1/mm.
    """

    depth: Float[Array, ""]
    power: Float[Array, ""]


class Iris(eqx.Module):
    """The iris: rays farther from the axis than its radius are vignetted.

    Attributes:
        depth: zeta, mm below the cornea's vertex.
        radius: of the dilated pupil, mm.
    """

    depth: Float[Array, ""]
    radius: Float[Array, ""]


Element = Refracting | ThinLens | Iris


class TracedRays(NamedTuple):
    """Rays behind the last surface, in the frame of `Conic`.

    Attributes:
        point: a point of the ray inside the eye, mm.
        direction: unit direction.
        transmittance: fraction of the power that Fresnel's reflections leave.
        status: SEEN, VIGNETTED, REFLECTED or MISSED; the first that holds.
    """

    point: Float[Array, "*batch 3"]
    direction: Float[Array, "*batch 3"]
    transmittance: Float[Array, "*batch"]
    status: Int[Array, "*batch"]


def trace(
    elements: tuple[Element, ...],
    origin: Float[Array, "*batch 3"],
    direction: Float[Array, "*batch 3"],
    *,
    medium: Medium | None = None,
    front: ScalarLike = 0.0,
) -> TracedRays:
    """Trace rays through elements in the order in which light meets them.

    Args:
        elements: of the path; each refracting medium ends at the next surface.
        origin: mm, in the frame of `Conic`, in front of the first element.
        direction: unit vectors with a positive third component.
        medium: in which the rays start; None for air.
        front: depth of the surface at which that medium begins, mm.

    Returns:
        The rays behind the last surface. A vignetted ray is traced on; the values of a ray that
        misses a surface or is reflected have no meaning.
    """
    point, medium = origin, Medium(1.0) if medium is None else medium
    transmittance = jnp.ones(origin.shape[:-1])
    status = jnp.full(origin.shape[:-1], SEEN)
    for element in elements:
        if isinstance(element, Refracting):
            point, direction, meets = medium.to_surface(
                point, direction, element.surface, front=front
            )
            depth = element.surface.depth
            direction, passed, passes = refract(
                direction=direction,
                normal=element.surface.normal(point),
                index_incident=medium.index_at(point, front=front),
                index_transmitted=element.medium.index_at(point, front=depth),
            )
            status = _first(status, ~meets, MISSED)
            status = _first(status, ~passes, REFLECTED)
            transmittance = transmittance * passed
            medium, front = element.medium, depth
        else:
            point = _at_depth(point, direction, element.depth)
            x, y, _ = components(point)
            if isinstance(element, Iris):
                # Squares, because the derivative of the root is infinite on the axis.
                status = _first(status, x * x + y * y > element.radius**2, VIGNETTED)
            else:
                direction = _deflected(direction, -element.power * x, -element.power * y)
    return TracedRays(point, direction, transmittance, status)


def _at_depth(
    point: Float[Array, "*batch 3"], direction: Float[Array, "*batch 3"], depth: ScalarLike
) -> Float[Array, "*batch 3"]:
    along = (depth - point[..., 2]) / direction[..., 2]
    return point + along[..., None] * direction


def _deflected(
    direction: Float[Array, "*batch 3"], by_x: Float[Array, "*batch"], by_y: Float[Array, "*batch"]
) -> Float[Array, "*batch 3"]:
    dx, dy, dz = components(direction)
    slope = jnp.stack([dx / dz + by_x, dy / dz + by_y, jnp.ones_like(dz)], axis=-1)
    return slope / jnp.linalg.norm(slope, axis=-1, keepdims=True)


def _first(status: Int[Array, "*batch"], fails: Array, code: int) -> Int[Array, "*batch"]:
    return jnp.where((status == SEEN) & fails, code, status)
