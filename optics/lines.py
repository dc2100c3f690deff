"""Where do lines about an axis meet a wall, and where does a pinhole see a point of it?

The functions accept floats, NumPy arrays and JAX arrays. They compute in JAX if an argument is a
JAX array, otherwise in NumPy, without importing JAX: a program on the robot uses them without it.

Three-vectors are computed by components: XLA on a CPU vectorises over the batch only if no
operation runs along an axis of length three. For the contour of a spot this reduces the time from
10 to 1.2 us.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from jaxtyping import ArrayLike, Bool, Float

    Array = Any  # NumPy's or JAX's


def array_namespace(*values: ArrayLike) -> Any:
    """`jax.numpy` if one of the values is a JAX array (traced or not), otherwise `numpy`."""
    for value in values:  # a loop, since a budget's frame comes here 200 times
        if not isinstance(value, np.ndarray | np.generic) and hasattr(value, "__array_namespace__"):
            return value.__array_namespace__()
    return np


def components(vectors: Float[Array, "*batch 3"]) -> tuple[Float[Array, "*batch"], ...]:
    """The x, y and z of vectors."""
    return tuple(vectors[..., k] for k in range(3))


def dot(a: Float[Array, "*batch 3"], b: Float[Array, "*batch 3"]) -> Float[Array, "*batch"]:
    """Scalar product."""
    (ax, ay, az), (bx, by, bz) = components(a), components(b)
    return ax * bx + ay * by + az * bz


def ray_point(
    origin: Float[Array, "*batch 3"],
    direction: Float[Array, "*batch 3"],
    distance: Float[Array, "*batch"],
) -> Float[Array, "*batch 3"]:
    """Point of a ray at a distance from its origin."""
    xp = array_namespace(origin, direction, distance)
    starts, steps = components(origin), components(direction)
    return xp.stack([o + distance * d for o, d in zip(starts, steps, strict=True)], axis=-1)


def generator_angles(count: int) -> np.ndarray:
    """Angles of `count` generators uniform around the axis, rad."""
    return np.arange(count) * (2.0 * np.pi / count)


def directions_across(
    axis: Float[ArrayLike, "*batch 3"], angle: Float[ArrayLike, "*batch"]
) -> Float[Array, "*batch 3"]:
    """Unit vectors across an axis, at angles (rad) around it from its `perpendicular_frame`."""
    xp = array_namespace(axis, angle)
    first, second = perpendicular_frame(axis)
    return xp.cos(angle)[..., None] * first + xp.sin(angle)[..., None] * second


def perpendicular_frame(
    axis: Float[ArrayLike, "*batch 3"],
) -> tuple[Float[Array, "*batch 3"], Float[Array, "*batch 3"]]:
    """Two unit vectors that complete `axis` to a right-handed frame (Duff et al. 2017)."""
    xp = array_namespace(axis)
    x, y, z = components(xp.asarray(axis))
    sign = xp.where(z >= 0, 1.0, -1.0)
    a = -1.0 / (sign + z)
    b = x * y * a
    return (
        xp.stack([1.0 + sign * x * x * a, sign * b, -sign * x], axis=-1),
        xp.stack([b, sign + y * y * a, -y], axis=-1),
    )


def cone_generators(
    axis: Float[Array, "*batch 3"],
    half_angle: Float[Array, "*batch"],
    angles: Float[Array, "*batch"],
) -> Float[Array, "*batch 3"]:
    """Unit directions of a cone's generators at angles (rad) around its axis."""
    xp = array_namespace(axis, half_angle, angles)
    along, aside = xp.cos(half_angle)[..., None], xp.sin(half_angle)[..., None]
    return along * axis + aside * directions_across(axis, angles)


def distance_in_sphere(
    origin: Float[Array, "*batch 3"], direction: Float[Array, "*batch 3"], radius: ArrayLike
) -> tuple[Float[Array, "*batch"], Bool[Array, "*batch"]]:
    """Distance along unit vectors to where they leave a sphere around the eye's centre, mm.

    Returns:
        The distances, and whether the lines meet the sphere.
    """
    xp = array_namespace(origin, direction, radius)
    along = dot(origin, direction)
    discriminant = along**2 + radius**2 - dot(origin, origin)
    meets = discriminant > 0
    # The inner `where` keeps the square root's derivative finite for rays that miss.
    return xp.sqrt(xp.where(meets, discriminant, 1.0)) - along, meets


def distance_to_plane(
    origin: Float[Array, "*batch 3"],
    direction: Float[Array, "*batch 3"],
    point: Float[Array, "*batch 3"],
    inward: Float[Array, "*batch 3"],
) -> tuple[Float[Array, "*batch"], Bool[Array, "*batch"]]:
    """Distance along unit vectors to a plane through a point, with an inward normal, mm.

    Returns:
        The distances, and whether the lines meet the plane.
    """
    xp = array_namespace(origin, direction, point, inward)
    approach = -dot(direction, inward)
    meets = approach != 0
    return dot(origin - point, inward) / xp.where(meets, approach, 1.0), meets


def pinhole_image(
    points: Float[Array, "*batch 3"],
    *,
    scale: ArrayLike,
    inverse_working_distance: ArrayLike,
    pole_height: ArrayLike,
) -> Float[Array, "*batch 2"]:
    """Undistorted image of points from the principal point, px: the formula of `Microscope`."""
    xp = array_namespace(points, scale, inverse_working_distance, pole_height)
    x, y, z = components(points)
    per_mm = 1.0 / (scale * (1.0 - inverse_working_distance * (z - pole_height)))
    return xp.stack([x * per_mm, -y * per_mm], axis=-1)


def plane_point(
    *,
    right_px: ArrayLike,
    down_px: ArrayLike,
    scale: ArrayLike,
    eye_radius: ArrayLike,
    inverse_working_distance: ArrayLike,
    normal: tuple[float, float, float],
) -> Float[Array, "3 *batch"]:
    r"""Intersection of an image point's line of sight with a plane through the pole.

    At a height t above the pole the line is at q (1 - kappa t), as for `eyeball_point`. It meets
    the plane at $t = -\mathbf n\cdot\mathbf q/(n_z - \kappa\,\mathbf n\cdot\mathbf q)$.

    Args: as for `eyeball_point`; `normal` is the plane's, n_z > 0.

    Returns:
        X, Y, Z on the first axis, mm, eye frame; NaN if the line does not meet the plane.
    """
    xp = array_namespace(right_px, down_px, scale, eye_radius, inverse_working_distance)
    x, y = scale * xp.asarray(right_px), scale * -xp.asarray(down_px)
    lean = normal[0] * x + normal[1] * y
    slope = normal[2] - inverse_working_distance * lean
    height = -lean / xp.where(slope > 0, slope, xp.nan)
    narrowing = 1.0 - inverse_working_distance * height
    return xp.stack([x * narrowing, y * narrowing, height - eye_radius])


def eyeball_point(
    *,
    right_px: ArrayLike,
    down_px: ArrayLike,
    scale: ArrayLike,
    eye_radius: ArrayLike,
    inverse_working_distance: ArrayLike,
) -> Float[Array, "3 *batch"]:
    """Intersection of an image point's line of sight with the retina.

    At the pole's height the line is at q = delta (right, -down). At a height t above the pole it is
    at q (1 - kappa t). On the sphere q^2 (1 - kappa t)^2 + (t - r)^2 = r^2, whose lower root t is
    the retina.

    Args:
        right_px: image point, to the right of the principal point, px.
        down_px: image point, below the principal point, px.
        scale: delta, mm/px at the pole.
        eye_radius: r, mm.
        inverse_working_distance: kappa = 1/(z_F + r), 1/mm; 0 is telecentric.

    Returns:
        X, Y, Z on the first axis, mm, eye frame.
    """
    xp = array_namespace(right_px, down_px, scale, eye_radius, inverse_working_distance)
    r, kappa = xp.asarray(eye_radius), inverse_working_distance
    x, y = scale * xp.asarray(right_px), scale * -xp.asarray(down_px)
    square = x**2 + y**2
    p, q = 1.0 + kappa**2 * square, r + kappa * square
    height = square / (q + xp.sqrt(q**2 - p * square))
    narrowing = 1.0 - kappa * height
    return xp.stack([x * narrowing, y * narrowing, height - r])
