"""Rays from the core's face through the cap, and the power they carry."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Bool, Float, Int

from optics.irradiance_edges import implicit_root, scan_boundaries, settle
from optics.lens import GlueLens
from optics.refraction import refract

TRANSMITTED, TOTAL_INTERNAL_REFLECTION, MISSED_APERTURE = 0, 1, 2

_HEIGHTS, _SINES, _TURNS = 20, 96, 96  # Gauss-Legendre nodes of the power's integral
_HEIGHT_CELLS = 24  # cells of the scan for the heights at which losses begin


class EmittedRays(NamedTuple):
    """Rays behind the cap, in the frame of the lens.

    Attributes:
        point: points where the rays leave the cap, mm.
        direction: unit vectors in the medium.
        transmittance: Fresnel transmittance of unpolarised light, 0 unless transmitted.
        status: TRANSMITTED, TOTAL_INTERNAL_REFLECTION, or MISSED_APERTURE for a ray that meets
            the side of the drop.
    """

    point: Float[Array, "*batch 3"]
    direction: Float[Array, "*batch 3"]
    transmittance: Float[Array, "*batch"]
    status: Int[Array, "*batch"]


@jax.jit
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
        points: start points on the core's face, mm from its centre.
        directions: components of the directions perpendicular to the axis, inside the glue. Their
            length is the sine of the angle to the axis, at most NA/n_g for light of the core.
    """
    meeting = _meet_cap(lens, points, directions)
    axis = jnp.array([0.0, 0.0, 1.0])
    normal = jnp.where(meeting.hits[..., None], lens.curvature * meeting.point + axis, axis)
    direction, transmittance, passes = refract(
        direction=meeting.direction,
        normal=normal,
        index_incident=lens.glue_index,
        index_transmitted=medium_index,
    )
    status = jnp.where(
        meeting.hits,
        jnp.where(passes, TRANSMITTED, TOTAL_INTERNAL_REFLECTION),
        MISSED_APERTURE,
    )
    transmittance = jnp.where(status == TRANSMITTED, transmittance, 0.0)
    return EmittedRays(meeting.point, direction, transmittance, status)


@jax.jit
def transmitted_power(lens: GlueLens, *, medium_index: ArrayLike) -> Float[Array, ""]:
    r"""Fraction of the core's power that leaves the cap without a reflection.

    $\Phi = \int\!\!\int L\,T\,d^2p\,d^2q$ over the core's face and the two components **q** of the
    direction perpendicular to the axis, with the Fresnel transmittance T. The other light is
    reflected into the glue or meets the side of the drop.

    Args:
        lens: the lens.
        medium_index: n0, refractive index of the medium.
    """
    node, weight = np.polynomial.legendre.leggauss(_SINES)
    turn_node, turn_weight = np.polynomial.legendre.leggauss(_TURNS)
    sine = 0.5 * lens.sine_limit * (node[:, None] + 1.0)
    sine_weight = 0.5 * lens.sine_limit * weight[:, None] * sine
    turn = 0.5 * np.pi * (turn_node + 1.0)
    direction = jnp.stack(jnp.broadcast_arrays(sine * np.cos(turn), sine * np.sin(turn)), axis=-1)

    def place(height):
        return jnp.stack([height, jnp.zeros_like(height)], axis=-1)

    def excess(height):
        meeting = _meet_cap(lens, place(height), direction)
        sine_out = jnp.square(lens.glue_index / jnp.asarray(medium_index)) * (
            1.0 - jnp.square(meeting.cos_incident)
        )
        rim = jnp.sum(jnp.square(meeting.point[..., :2]), axis=-1) / lens.aperture_radius**2
        return jnp.where(meeting.meets, jnp.maximum(sine_out, rim), 2.0) - 1.0

    # For each direction, find the heights on the face between which no light is lost.
    share = np.linspace(0.0, 1.0, _HEIGHT_CELLS + 1).reshape(-1, 1, 1)
    height = lens.face_radius * share + jnp.zeros(direction.shape[:-1])
    values = excess(height)
    found, lit, dark = scan_boundaries(height, values, count=2)
    root = implicit_root(excess, settle(excess, lit, dark))
    end, other = jnp.where(found, root, lens.face_radius)
    starts_lit = values[0] < 0.0
    low, high = jnp.where(starts_lit, 0.0, end), jnp.where(starts_lit, end, other)

    # Near total internal reflection T falls like a square root; the cosine makes this smooth.
    node, weight = np.polynomial.legendre.leggauss(_HEIGHTS)
    turned = (0.5 * np.pi * (node + 1.0)).reshape(-1, 1, 1)
    height = low + (high - low) * (0.5 - 0.5 * np.cos(turned))
    height_weight = height * (high - low) * 0.25 * np.pi * np.sin(turned) * weight.reshape(-1, 1, 1)
    rays = emitted_rays(lens, medium_index=medium_index, points=place(height), directions=direction)
    radiance = lens.radiance(face_radius_squared=jnp.square(height), sine_squared=jnp.square(sine))
    # 2 pi for the azimuth on the face, 2 for the other half of the turns.
    measure = 4.0 * np.pi * height_weight * sine_weight * (0.5 * np.pi * turn_weight)
    return jnp.sum(measure * radiance * rays.transmittance)


class _Meeting(NamedTuple):
    """Where rays inside the glue meet the sphere of the cap."""

    point: Float[Array, "*batch 3"]
    direction: Float[Array, "*batch 3"]
    cos_incident: Float[Array, "*batch"]
    meets: Bool[Array, "*batch"]
    hits: Bool[Array, "*batch"]


def _meet_cap(lens: GlueLens, points: Array, directions: Array) -> _Meeting:
    """Intersect rays from the core's face with the cap; hits are those within the aperture."""
    points, directions = jnp.broadcast_arrays(
        jnp.asarray(points, dtype=float), jnp.asarray(directions, dtype=float)
    )
    forward = jnp.sqrt(1.0 - jnp.sum(jnp.square(directions), axis=-1, keepdims=True))
    direction = jnp.concatenate([directions, forward], axis=-1)
    start = jnp.concatenate([points, jnp.zeros_like(forward) - lens.glue_length], axis=-1)
    # The cap's sphere is κ|P|²/2 + P_s = 0, a plane for κ = 0; its upper crossing is the cap.
    curvature = lens.curvature
    half_slope = 0.5 * (curvature * jnp.sum(start * direction, axis=-1) + direction[..., 2])
    offset = 0.5 * curvature * jnp.sum(jnp.square(start), axis=-1) + start[..., 2]
    discriminant = jnp.square(half_slope) - 0.5 * curvature * offset
    meets = discriminant > 0.0
    denominator = half_slope + jnp.sqrt(jnp.where(meets, discriminant, 1.0))
    path = -offset / jnp.where(denominator == 0.0, 1.0, denominator)
    point = start + path[..., None] * direction
    normal = curvature * point + jnp.array([0.0, 0.0, 1.0])
    radius_squared = jnp.sum(jnp.square(point[..., :2]), axis=-1)
    # Below its equator the sphere is not the cap.
    upper = meets & (normal[..., 2] > 0.0)
    return _Meeting(
        point=point,
        direction=direction,
        cos_incident=jnp.sum(direction * normal, axis=-1),
        meets=upper,
        hits=upper & (radius_squared <= jnp.square(lens.aperture_radius)),
    )
