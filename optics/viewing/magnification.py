"""What a pixel sees on the wall, and the local magnification there, which a spot's size needs."""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

from optics import Camera, Surface
from optics.viewing.camera import PathCamera


@eqx.filter_jit
def wall_point(
    camera: PathCamera, wall: Surface, pixels: Float[ArrayLike, "*batch 2"]
) -> Float[Array, "*batch 3"]:
    """Point of the wall that pixels see through a path, mm; NaN where the iris or the field ends.

    Args:
        camera: the viewing path.
        wall: the wall.
        pixels: (u, v), px.
    """
    point = wall.intersect(*camera.ray(pixels)).point
    seen = camera.transmittance(jnp.asarray(pixels)) > 0
    return jnp.where(seen[..., None], point, jnp.nan)


@eqx.filter_jit
def local_magnification(
    camera: Camera,
    wall: Surface,
    *,
    eccentricity: Float[ArrayLike, "*batch"],
    azimuth: Float[ArrayLike, "*batch"] = 0.0,
) -> Float[Array, "*batch 2"]:
    r"""Semi-axes of the image of a small circle on the wall, relative to a circle at the pole.

    Through a path that is symmetric about the axis, and on a wall of revolution, they are the
    magnifications across the meridian, h/c, and along it, dh/ds, with the image height h in mm at
    the pole and the arc s. A circle of radius e1 has the semi-minor axis e1'; so
    $e_1 = \delta e_1' / m$ with the smaller magnification m. `corrected_factor` is 1/m for a
    pinhole and a sphere.

    Args:
        camera: a viewing path, or a microscope.
        wall: the wall.
        eccentricity: c of the points, mm.
        azimuth: of the points, rad.

    Returns:
        The larger and the smaller one, 1 at the pole.
    """

    def at(c: Float[Array, ""], angle: Float[Array, ""]) -> Float[Array, "2"]:
        frame = wall.frame_at(eccentricity=c, azimuth=angle)
        tangents = jnp.stack([frame.meridional, frame.azimuthal], axis=-1)
        (p, q), (r, s) = camera.scale * jax.jacfwd(camera.project)(frame.origin) @ tangents
        # Singular values of a 2x2 matrix.
        one, other = jnp.hypot(p + s, q - r), jnp.hypot(p - s, q + r)
        return jnp.stack([one + other, jnp.abs(one - other)]) / 2.0

    return jnp.vectorize(at, signature="(),()->(k)")(
        jnp.asarray(eccentricity, float), jnp.asarray(azimuth, float)
    )
