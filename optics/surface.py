"""The walls: a plane with any normal, and the eyeball's sphere."""

from __future__ import annotations

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float, Int, ScalarLike

from optics.vector import dot, ray_point

HIT, MISS, BEHIND = 0, 1, 2
"""Status of an intersection: the wall is ahead, is not met, or is behind the origin."""


class Intersection(NamedTuple):
    """Intersection of rays with a wall; `point` and `distance` are valid only if `status` is HIT.

    Attributes:
        distance: distance along the unit direction, mm.
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
    """Eyeball phantom: a sphere around the origin of the eye frame, seen from inside.

    Attributes:
        radius: r, mm.
    """

    radius: Float[Array, ""]

    def __init__(self, radius: ScalarLike) -> None:
        self.radius = jnp.asarray(radius, float)

    def intersect(
        self, origin: Float[Array, "*batch 3"], direction: Float[Array, "*batch 3"]
    ) -> Intersection:
        """Far intersection of rays with the sphere, where they leave the eye."""
        along = dot(origin, direction)
        discriminant = along**2 + self.radius**2 - dot(origin, origin)
        meets = discriminant > 0
        # The inner `where` keeps the square root's derivative finite for rays that miss.
        distance = jnp.sqrt(jnp.where(meets, discriminant, 1.0)) - along
        point = ray_point(origin, direction, distance)
        status = jnp.where(meets, jnp.where(distance > 0, HIT, BEHIND), MISS)
        return Intersection(distance, point, -point / self.radius, status)

    def frame_at(self, *, eccentricity: ScalarLike, azimuth: ScalarLike) -> WallFrame:
        """Frame at the wall point with the given distance from the axis (mm) and azimuth (rad)."""
        sin_phi = jnp.asarray(eccentricity) / self.radius
        cos_phi = jnp.sqrt(1.0 - sin_phi**2)
        cos_a, sin_a = jnp.cos(jnp.asarray(azimuth)), jnp.sin(jnp.asarray(azimuth))
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

    point: Float[Array, "3"]
    inward: Float[Array, "3"]

    def __init__(self, *, point: Float[ArrayLike, "3"], inward: Float[ArrayLike, "3"]) -> None:
        self.point, self.inward = jnp.asarray(point, float), jnp.asarray(inward, float)

    def intersect(
        self, origin: Float[Array, "*batch 3"], direction: Float[Array, "*batch 3"]
    ) -> Intersection:
        """Intersection of rays with the plane."""
        approach = -dot(direction, self.inward)
        parallel = approach == 0
        height = dot(origin - self.point, self.inward)
        distance = height / jnp.where(parallel, 1.0, approach)
        status = jnp.where(parallel, MISS, jnp.where(distance > 0, HIT, BEHIND))
        point = ray_point(origin, direction, distance)
        return Intersection(distance, point, jnp.broadcast_to(self.inward, point.shape), status)

    def frame_at(self, *, eccentricity: ScalarLike, azimuth: ScalarLike) -> WallFrame:
        """Frame at the wall point with the given distance from the axis (mm) and azimuth (rad)."""
        angle = jnp.asarray(azimuth, float)
        radial = jnp.stack([jnp.cos(angle), jnp.sin(angle), jnp.zeros_like(angle)])
        vertical = jnp.array([0.0, 0.0, 1.0])
        foot = jnp.asarray(eccentricity) * radial
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
    *, eye_radius: ScalarLike, tilt: ScalarLike = 0.0, tilt_azimuth: ScalarLike = 0.0
) -> Plane:
    """Plane phantom through the retinal pole, tilted around it.

    Args:
        eye_radius: r, mm: the plane passes through (0, 0, -r).
        tilt: angle between its normal and the microscope's axis, rad.
        tilt_azimuth: azimuth of the direction in which the normal tilts, rad.
    """
    lean, towards = jnp.asarray(tilt, float), jnp.asarray(tilt_azimuth, float)
    sideways = jnp.sin(lean)
    inward = jnp.stack([sideways * jnp.cos(towards), sideways * jnp.sin(towards), jnp.cos(lean)])
    return Plane(point=jnp.stack([0.0, 0.0, -jnp.asarray(eye_radius)]), inward=inward)
