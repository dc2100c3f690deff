"""The walls: a plane with any normal, the eyeball's sphere, and an ellipsoid."""

from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float, Int, ScalarLike

from eyespot.optics.lines import (
    components,
    distance_in_sphere,
    distance_to_plane,
    dot,
    ray_point,
)


def bisected(
    holds: Callable[[Array], Array], inside: Array, outside: Array, *, steps: int
) -> tuple[Array, Array]:
    """Brackets, halved so many times: ends where a condition holds, and ends where it does not."""

    def halve(_: int, ends: tuple[Array, Array]) -> tuple[Array, Array]:
        middle = 0.5 * (ends[0] + ends[1])
        here = holds(middle)
        return jnp.where(here, middle, ends[0]), jnp.where(here, ends[1], middle)

    found: tuple[Array, Array] = jax.lax.fori_loop(0, steps, halve, (inside, outside))
    return found


HIT, MISS, BEHIND = 0, 1, 2
"""Status of an intersection: the wall is ahead, is not met, or is behind the origin."""

_BISECTIONS = 60


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
        self, origin: Float[ArrayLike, "*batch 3"], direction: Float[ArrayLike, "*batch 3"]
    ) -> Intersection:
        """Far intersection of rays with the sphere, where they leave the eye."""
        origin, direction = jnp.asarray(origin), jnp.asarray(direction)
        distance, meets = distance_in_sphere(origin, direction, self.radius)
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


def _frame(
    surface: "Plane | Ellipsoid", *, eccentricity: ScalarLike, azimuth: ScalarLike
) -> WallFrame:
    """Frame at the wall point with the given distance from the axis (mm) and azimuth (rad)."""
    angle = jnp.asarray(azimuth, float)
    radial = jnp.stack([jnp.cos(angle), jnp.sin(angle), jnp.zeros_like(angle)])
    down = jnp.array([0.0, 0.0, -1.0])
    hit = surface.intersect(jnp.asarray(eccentricity) * radial, down)
    tangent = radial - down * jnp.dot(radial, hit.normal) / jnp.dot(down, hit.normal)
    meridional = tangent / jnp.linalg.norm(tangent)
    return WallFrame(hit.point, -hit.normal, meridional, jnp.cross(hit.normal, meridional))


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
        self, origin: Float[ArrayLike, "*batch 3"], direction: Float[ArrayLike, "*batch 3"]
    ) -> Intersection:
        """Intersection of rays with the plane."""
        origin, direction = jnp.asarray(origin), jnp.asarray(direction)
        distance, meets = distance_to_plane(origin, direction, self.point, self.inward)
        status = jnp.where(meets, jnp.where(distance > 0, HIT, BEHIND), MISS)
        point = ray_point(origin, direction, distance)
        return Intersection(distance, point, jnp.broadcast_to(self.inward, point.shape), status)

    frame_at = _frame

    def nearest_distance(self, point: Float[Array, "3"]) -> Float[Array, ""]:
        """Distance from a point to the plane, mm; negative behind it."""
        return jnp.dot(point - self.point, self.inward)


class Ellipsoid(eqx.Module):
    """A retina with three semi-axes, seen from inside; it may be turned about its centre.

    The microscope's axis meets it at the pole, (0, 0, -semi_axes[2]): a turned or shifted ellipsoid
    is raised or lowered to have its pole there.

    Attributes:
        semi_axes: along the ellipsoid's own x, y and z, mm.
        centre: eye frame, mm.
        turn: rotation matrix from the ellipsoid's own frame to the eye frame.
    """

    semi_axes: Float[Array, "3"]
    centre: Float[Array, "3"]
    turn: Float[Array, "3 3"]

    def __init__(
        self,
        semi_axes: Float[ArrayLike, "3"],
        *,
        shift: tuple[ScalarLike, ScalarLike] = (0.0, 0.0),
        tilt: ScalarLike = 0.0,
        tilt_azimuth: ScalarLike = 0.0,
    ) -> None:
        """Place the ellipsoid.

        Args:
            semi_axes: x, y and z, mm.
            shift: of the centre across the microscope's axis, mm.
            tilt: angle between the ellipsoid's z and the microscope's axis, rad.
            tilt_azimuth: azimuth of the direction in which its z leans, rad.
        """
        self.semi_axes = jnp.asarray(semi_axes, float)
        self.turn = _leaning(jnp.asarray(tilt, float), jnp.asarray(tilt_azimuth, float))
        aside = jnp.stack([*(jnp.asarray(s, float) for s in shift), jnp.zeros(())])
        self.centre = aside
        # The axis from the height of the centre down to the wall.
        below = self.intersect(jnp.zeros(3), jnp.array([0.0, 0.0, -1.0])).distance
        self.centre = aside + jnp.array([0.0, 0.0, 1.0]) * (below - self.semi_axes[2])

    def intersect(
        self, origin: Float[ArrayLike, "*batch 3"], direction: Float[ArrayLike, "*batch 3"]
    ) -> Intersection:
        """Far intersection of rays with the ellipsoid, where they leave the eye."""
        origin, direction = jnp.asarray(origin), jnp.asarray(direction)
        # In the ellipsoid's own frame, divided by the semi-axes, it is the unit sphere.
        starts, steps = self._unit(origin - self.centre), self._unit(direction)
        squared, along = dot(steps, steps), dot(starts, steps)
        discriminant = along**2 - squared * (dot(starts, starts) - 1.0)
        meets = discriminant > 0
        root = jnp.sqrt(jnp.where(meets, discriminant, 1.0))
        distance = (root - along) / squared
        point = ray_point(origin, direction, distance)
        status = jnp.where(meets, jnp.where(distance > 0, HIT, BEHIND), MISS)
        return Intersection(distance, point, self._inward(point), status)

    frame_at = _frame

    def nearest_distance(self, point: Float[Array, "3"]) -> Float[Array, ""]:
        """Distance from a point inside the eye to the nearest wall point, mm.

        The foot of the perpendicular, x = a^2 p / (a^2 + t), solves |x / a| = 1 for t < 0 (Eberly
        2013, "Distance from a point to an ellipsoid"); the root is found by bisection.
        """
        own = self.turn.T @ (point - self.centre)
        squares = jnp.square(self.semi_axes)

        def foot(t: Float[Array, ""]) -> Float[Array, "3"]:
            return squares * own / (squares + t)

        def outside(t: Float[Array, ""]) -> Array:
            return jnp.sum(jnp.square(foot(t) / self.semi_axes)) > 1.0

        _, root = bisected(outside, -jnp.min(squares), jnp.zeros(()), steps=_BISECTIONS)
        return jnp.linalg.norm(foot(root) - own)

    def _unit(self, vectors: Float[Array, "*batch 3"]) -> Float[Array, "*batch 3"]:
        x, y, z = components(vectors)
        rows = zip(self.turn.T, self.semi_axes, strict=True)
        return jnp.stack([(r[0] * x + r[1] * y + r[2] * z) / a for r, a in rows], axis=-1)

    def _inward(self, point: Float[Array, "*batch 3"]) -> Float[Array, "*batch 3"]:
        unit = components(self._unit(point - self.centre))
        own = [-u / a for u, a in zip(unit, self.semi_axes, strict=True)]
        turned = jnp.stack([sum(row[k] * own[k] for k in range(3)) for row in self.turn], axis=-1)
        return turned / jnp.linalg.norm(turned, axis=-1, keepdims=True)


Surface = Sphere | Plane | Ellipsoid


def _leaning(tilt: Float[Array, ""], azimuth: Float[Array, ""]) -> Float[Array, "3 3"]:
    """Rotation that tilts z towards an azimuth (Rodrigues)."""
    sin_a, cos_a = jnp.sin(azimuth), jnp.cos(azimuth)
    zero = jnp.zeros(())
    k = jnp.array([[zero, zero, cos_a], [zero, zero, sin_a], [-cos_a, -sin_a, zero]])
    return jnp.eye(3) + jnp.sin(tilt) * k + (1.0 - jnp.cos(tilt)) * (k @ k)


def pole_plane(
    *, eye_radius: ScalarLike, tilt: ScalarLike = 0.0, tilt_azimuth: ScalarLike = 0.0
) -> Plane:
    """Plane phantom through the retinal pole, tilted around it.

    Args:
        eye_radius: r, mm: the plane passes through (0, 0, -r).
        tilt: angle between its normal and the microscope's axis, rad.
        tilt_azimuth: azimuth of the direction in which the normal tilts, rad.
    """
    inward = _leaning(jnp.asarray(tilt, float), jnp.asarray(tilt_azimuth, float))[:, 2]
    return Plane(point=jnp.stack([0.0, 0.0, -jnp.asarray(eye_radius)]), inward=inward)
