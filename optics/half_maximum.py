"""The contour where direct irradiance on the wall is half of its peak."""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from optics.beam import Beam, generator_angles, perpendicular_frame
from optics.contour import CONTOUR_POINTS
from optics.irradiance_edges import implicit_root
from optics.irradiance_lookup import IrradianceTable
from optics.surface import HIT, Surface
from optics.vector import dot

_RADII = 256
_BISECTIONS = 30


def wall_irradiance(
    table: IrradianceTable,
    beam: Beam,
    surface: Surface,
    *,
    radius: Float[Array, "*batch"],
    angle: Float[Array, "*batch"],
) -> tuple[Float[Array, "*batch"], Float[Array, "*batch 3"]]:
    """Direct irradiance of the wall at points given by their offset from the beam's axis.

    E = -n . V with the wall's inward normal n; zero behind the plane of the tip.

    Args:
        table: vector irradiance per unit power.
        beam: tip and axis; its cone is not used.
        surface: the wall.
        radius: rho, distance of the wall point from the axis, mm.
        angle: angle around the axis, rad.

    Returns:
        E per unit power, 1/mm^2, and the wall points, mm.
    """
    first, second = perpendicular_frame(beam.axis)
    around = jnp.cos(angle)[..., None] * first + jnp.sin(angle)[..., None] * second
    wall = surface.intersect(beam.tip + radius[..., None] * around, _like(beam.axis, around))
    lateral, axial = table(radius=radius, distance=wall.distance)
    vector = lateral[..., None] * around + axial[..., None] * beam.axis
    irradiance = -dot(wall.normal, vector)
    return jnp.where(wall.status == HIT, jnp.maximum(irradiance, 0.0), 0.0), wall.point


def half_maximum_contour(
    table: IrradianceTable, beam: Beam, surface: Surface, *, points: int = CONTOUR_POINTS
) -> Float[Array, "n 3"]:
    """Outermost curve on the wall at half of the peak of the direct irradiance.

    Args:
        table: vector irradiance of the lens.
        beam: tip and axis.
        surface: the wall, Lambertian and uniform.
        points: number of points, uniform in angle around the beam's axis.

    Returns:
        Wall points, mm; without noise, occlusion and indirect light.
    """
    angles = jnp.asarray(generator_angles(points))
    reach = table.envelope(jnp.linalg.norm(beam.spot(surface).distance) * 1.5 + 0.5)
    radii = jnp.linspace(0.0, 1.0, _RADII) * reach
    grid_radius, grid_angle = jnp.meshgrid(radii, angles)
    profile, _ = wall_irradiance(table, beam, surface, radius=grid_radius, angle=grid_angle)
    level = 0.5 * jnp.max(profile)

    def excess(radius: Array) -> Array:
        return wall_irradiance(table, beam, surface, radius=radius, angle=angles)[0] - level

    above = profile >= level
    last = _RADII - 1 - jnp.argmax(above[:, ::-1], axis=-1)
    low, high = radii[last], radii[jnp.minimum(last + 1, _RADII - 1)]

    def halve(_: int, bracket: tuple[Array, Array]) -> tuple[Array, Array]:
        inside, outside = bracket
        middle = 0.5 * (inside + outside)
        bright = excess(middle) >= 0
        return jnp.where(bright, middle, inside), jnp.where(bright, outside, middle)

    low, high = jax.lax.stop_gradient(jax.lax.fori_loop(0, _BISECTIONS, halve, (low, high)))
    edge = implicit_root(excess, 0.5 * (low + high))
    return wall_irradiance(table, beam, surface, radius=edge, angle=angles)[1]


def _like(vector: Float[Array, "3"], batch: Float[Array, "*batch 3"]) -> Float[Array, "*batch 3"]:
    return jnp.broadcast_to(vector, batch.shape)
