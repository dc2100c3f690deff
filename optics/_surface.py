"""Walls that the beam meets: a plane of any normal and the eyeball's sphere."""

from __future__ import annotations

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

HIT, MISS, BEHIND = 0, 1, 2
"""Status of an intersection: the wall lies ahead, is never met, or lies behind the origin."""


class Intersection(NamedTuple):
    """Where rays meet a wall; where `status` is not HIT, `point` and `distance` are finite fillers.

    Attributes:
        distance: along the unit direction, mm.
        point: mm, eye frame.
        normal: inward unit normal (into the eye) at `point`.
        status: HIT, MISS or BEHIND.
    """

    distance: Float[Array, "*batch"]
    point: Float[Array, "*batch 3"]
    normal: Float[Array, "*batch 3"]
    status: Int[Array, "*batch"]


class WallFrame(NamedTuple):
    """Orthonormal frame of the wall at a point O.

    Attributes:
        origin: O, mm.
        outward: unit normal out of the eye.
        meridional: unit tangent along which the eccentricity grows.
        azimuthal: unit tangent along which the azimuth grows.
    """

    origin: Float[Array, "3"]
    outward: Float[Array, "3"]
    meridional: Float[Array, "3"]
    azimuthal: Float[Array, "3"]


class Sphere(eqx.Module):
    """Eyeball phantom: a sphere round the origin of the eye frame, seen from inside.

    Attributes:
        radius: r, mm.
    """

    radius: Float[Array, ""] = eqx.field(converter=jnp.asarray)

    def intersect(
        self, origin: Float[Array, "*batch 3"], direction: Float[Array, "*batch 3"]
    ) -> Intersection:
        """Far intersection of rays with the sphere: the one at which they leave the eye."""
        along = jnp.sum(origin * direction, axis=-1)
        discriminant = along**2 + self.radius**2 - jnp.sum(origin * origin, axis=-1)
        meets = discriminant > 0
        # The inner `where` keeps the square root's derivative finite where the ray misses.
        distance = jnp.sqrt(jnp.where(meets, discriminant, 1.0)) - along
        point = origin + distance[..., None] * direction
        status = jnp.where(meets, jnp.where(distance > 0, HIT, BEHIND), MISS)
        return Intersection(distance, point, -point / self.radius, status)

    def frame_at(
        self, *, eccentricity: Float[Array, ""], azimuth: Float[Array, ""]
    ) -> WallFrame:
        """Frame at the wall point with the given distance from the axis (mm) and azimuth (rad)."""
        sin_phi = eccentricity / self.radius
        cos_phi = jnp.sqrt(1.0 - sin_phi**2)
        cos_a, sin_a = jnp.cos(azimuth), jnp.sin(azimuth)
        outward = jnp.stack([sin_phi * cos_a, sin_phi * sin_a, -cos_phi])
        meridional = jnp.stack([cos_phi * cos_a, cos_phi * sin_a, sin_phi])
        azimuthal = jnp.stack([-sin_a, cos_a, jnp.zeros_like(sin_a)])
        return WallFrame(self.radius * outward, outward, meridional, azimuthal)

    def nearest_distance(self, point: Float[Array, "3"]) -> Float[Array, ""]:
        """Distance from a point inside the eye to the nearest wall point, mm."""
        return self.radius - jnp.linalg.norm(point)


class Plane(eqx.Module):
    """Plane phantom.

    Attributes:
        point: any point of the plane, mm.
        inward: unit normal towards the instrument.
    """

    point: Float[Array, "3"] = eqx.field(converter=jnp.asarray)
    inward: Float[Array, "3"] = eqx.field(converter=jnp.asarray)

    def intersect(
        self, origin: Float[Array, "*batch 3"], direction: Float[Array, "*batch 3"]
    ) -> Intersection:
        """Intersection of rays with the plane."""
        approach = -jnp.sum(direction * self.inward, axis=-1)
        parallel = approach == 0
        height = jnp.sum((origin - self.point) * self.inward, axis=-1)
        distance = height / jnp.where(parallel, 1.0, approach)
        status = jnp.where(parallel, MISS, jnp.where(distance > 0, HIT, BEHIND))
        point = origin + distance[..., None] * direction
        return Intersection(distance, point, jnp.broadcast_to(self.inward, point.shape), status)

    def frame_at(
        self, *, eccentricity: Float[Array, ""], azimuth: Float[Array, ""]
    ) -> WallFrame:
        """Frame at the wall point with the given distance from the axis (mm) and azimuth (rad)."""
        radial = jnp.stack([jnp.cos(azimuth), jnp.sin(azimuth), jnp.zeros_like(azimuth)])
        vertical = jnp.array([0.0, 0.0, 1.0])
        foot = eccentricity * radial
        drop = jnp.dot(self.point - foot, self.inward) / jnp.dot(vertical, self.inward)
        tangent = radial - vertical * jnp.dot(radial, self.inward) / jnp.dot(vertical, self.inward)
        meridional = tangent / jnp.linalg.norm(tangent)
        return WallFrame(
            foot + drop * vertical, -self.inward, meridional, jnp.cross(self.inward, meridional)
        )

    def nearest_distance(self, point: Float[Array, "3"]) -> Float[Array, ""]:
        """Distance from a point to the plane, mm; negative behind it."""
        return jnp.dot(point - self.point, self.inward)


Surface = Sphere | Plane


def pole_plane(
    *, eye_radius: float, tilt: float = 0.0, tilt_azimuth: float = 0.0
) -> Plane:
    """Plane phantom through the retinal pole, tilted about it.

    Args:
        eye_radius: r, mm: the plane passes through (0, 0, -r).
        tilt: angle between its normal and the microscope's axis, rad.
        tilt_azimuth: direction into which the normal leans, rad.
    """
    inward = jnp.stack(
        [
            jnp.sin(tilt) * jnp.cos(tilt_azimuth),
            jnp.sin(tilt) * jnp.sin(tilt_azimuth),
            jnp.cos(jnp.asarray(tilt, float)),
        ]
    )
    return Plane(point=jnp.array([0.0, 0.0, -eye_radius]), inward=inward)
