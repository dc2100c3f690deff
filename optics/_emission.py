"""Light on its way out: rays from the core's face through the cap, and the power they carry."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Float, Int

from optics._lens import GlueLens
from optics._refraction import refract

TRANSMITTED, TOTAL_INTERNAL_REFLECTION, MISSED_APERTURE = 0, 1, 2

_HEIGHTS, _SINES, _TURNS = 48, 24, 24  # Gauss-Legendre nodes of the power's integral


class EmittedRays(NamedTuple):
    """Rays behind the cap, in the frame of the lens.

    Attributes:
        point: where they leave the cap, mm.
        direction: unit vectors in the medium.
        transmittance: Fresnel transmittance of unpolarised light, 0 unless transmitted.
        status: TRANSMITTED, TOTAL_INTERNAL_REFLECTION, or MISSED_APERTURE for a ray that meets
            the side of the drop.
    """

    point: Float[Array, "*batch 3"]
    direction: Float[Array, "*batch 3"]
    transmittance: Float[Array, "*batch"]
    status: Int[Array, "*batch"]


def emitted_rays(
    lens: GlueLens,
    *,
    medium_index: ArrayLike,
    points: Float[Array, "*batch 2"],
    directions: Float[Array, "*batch 2"],
) -> EmittedRays:
    """Trace rays from the core's face through the cap into the medium.

    Args:
        lens: the lens.
        medium_index: n0, refractive index of the medium.
        points: where the rays start on the core's face, mm from its centre.
        directions: the directions' two components across the axis inside the glue (their length
            is the sine of the angle to the axis, NA/n_g at most for light of the core).
    """
    points, directions = jnp.asarray(points, dtype=float), jnp.asarray(directions, dtype=float)
    forward = jnp.sqrt(1.0 - jnp.sum(jnp.square(directions), axis=-1, keepdims=True))
    direction = jnp.concatenate([directions, forward], axis=-1)
    start = jnp.concatenate([points, jnp.zeros_like(forward) - lens.glue_length], axis=-1)

    # The cap's sphere is κ|P|²/2 + P_s = 0, a plane for κ = 0; its upper crossing is the cap.
    curvature = lens.curvature
    half_slope = 0.5 * (curvature * jnp.sum(start * direction, axis=-1) + direction[..., 2])
    offset = 0.5 * curvature * jnp.sum(jnp.square(start), axis=-1) + start[..., 2]
    discriminant = jnp.square(half_slope) - 0.5 * curvature * offset
    meets = discriminant >= 0.0
    root = jnp.sqrt(jnp.where(discriminant > 0.0, discriminant, 1.0))
    denominator = half_slope + root
    path = -offset / jnp.where(denominator == 0.0, 1.0, denominator)
    point = start + path[..., None] * direction
    inside = jnp.hypot(point[..., 0], point[..., 1]) <= lens.aperture_radius
    # Below its equator the sphere is not the cap.
    hits = meets & inside & (curvature * point[..., 2] > -1.0)

    axis = jnp.array([0.0, 0.0, 1.0])
    normal = jnp.where(hits[..., None], curvature * point + axis, axis)
    bent, transmittance, passes = refract(
        direction=direction,
        normal=normal,
        index_incident=lens.glue_index,
        index_transmitted=medium_index,
    )
    status = jnp.where(
        hits, jnp.where(passes, TRANSMITTED, TOTAL_INTERNAL_REFLECTION), MISSED_APERTURE
    )
    return EmittedRays(point, bent, jnp.where(status == TRANSMITTED, transmittance, 0.0), status)
