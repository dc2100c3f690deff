"""Rays traced backwards from a wall point through the cap of a glue lens to the core's face."""

from typing import NamedTuple

import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from optics.lens import GlueLens
from optics.refraction import fresnel_transmittance, refracted_cosine


class BackwardRays(NamedTuple):
    """Light that reaches a wall point through points of the cap.

    Light arrives only within four limits. Each is given as an excess that is negative within it.

    Attributes:
        cone: sin² of the angle to the axis inside the glue over that of the numerical aperture,
            minus 1.
        face: squared radius at which the ray starts over that of the face's lit part, minus 1.
        drop: the larger of two excesses: the squared radius at which the ray passes the rim's plane
            over the aperture's, minus 1, and minus the cosine between the cap's normal and the
            direction to the wall point.
        lateral: dV_rho per area of the aperture's plane, without the limits, 1/mm⁴.
        axial: dV_s per area of the aperture's plane, without the limits, 1/mm⁴.
    """

    cone: Float[Array, "*batch"]
    face: Float[Array, "*batch"]
    drop: Float[Array, "*batch"]
    lateral: Float[Array, "*batch"]
    axial: Float[Array, "*batch"]

    @property
    def excess(self) -> Float[Array, "*batch"]:
        """Largest excess: negative where light arrives."""
        return jnp.maximum(jnp.maximum(self.cone, self.face), self.drop)


def trace_backwards(
    lens: GlueLens,
    *,
    medium_index: ArrayLike,
    radius: ArrayLike,
    distance: ArrayLike,
    cap_radius: Float[Array, "*batch"],
    haversine: Float[Array, "*batch"],
) -> BackwardRays:
    """Trace from a wall point through points of the cap to the core's face.

    Args:
        lens: the lens.
        medium_index: n0, refractive index of the medium.
        radius: distance of the wall point from the axis, mm.
        distance: distance of the wall point from the tip's plane, mm.
        cap_radius: distance of the cap point from the axis, mm, within the aperture.
        haversine: sin²(φ/2) of the angle φ around the axis from the wall point to the cap point.
            Unlike cos φ it stays accurate for small angles.
    """
    ratio = jnp.asarray(medium_index) / lens.glue_index
    curvature = lens.curvature
    # The normal of a hemisphere's rim is perpendicular to the axis; the bound avoids infinities.
    normal_s = jnp.sqrt(jnp.maximum(1.0 - jnp.square(curvature * cap_radius), 1e-12))
    depth = curvature * jnp.square(cap_radius) / (1.0 + normal_s)

    # In the plane perpendicular to the axis, components are along the cap point's radial unit
    # vector and perpendicular to it.
    cos, sin_squared = 1.0 - 2.0 * haversine, 4.0 * haversine * (1.0 - haversine)
    out_radial = radius * cos - cap_radius
    out_across_squared = jnp.square(radius) * sin_squared
    out_s = distance + depth
    length_squared = (
        jnp.square(radius - cap_radius) + 4.0 * radius * cap_radius * haversine + jnp.square(out_s)
    )
    per_length = 1.0 / jnp.sqrt(length_squared)
    out_radial, out_s = out_radial * per_length, out_s * per_length
    cos_medium = out_radial * curvature * cap_radius + out_s * normal_s
    cos_glue = refracted_cosine(cos_incident=cos_medium, index_ratio=ratio)
    bend = cos_glue - ratio * cos_medium
    in_radial = ratio * out_radial + bend * curvature * cap_radius
    in_s = ratio * out_s + bend * normal_s
    in_across_squared = jnp.square(ratio * per_length) * out_across_squared

    sine_squared = jnp.square(in_radial) + in_across_squared
    # Rays back towards the medium are outside every cone; 2 - sin² continues to increase there.
    opening = jnp.where(in_s > 0.0, sine_squared, 2.0 - sine_squared)
    per_forward = 1.0 / jnp.maximum(in_s, 1e-3)

    def crossing_squared(path):
        return jnp.square(cap_radius - path * in_radial) + jnp.square(path) * in_across_squared

    face_squared = crossing_squared((lens.glue_length - depth) * per_forward)
    rim_squared = crossing_squared((lens.sag - depth) * per_forward)
    # A ray from behind the cap carries nothing; Fresnel's formula has no negative cosines.
    facing = jnp.maximum(cos_medium, 0.0)
    transmittance = fresnel_transmittance(
        cos_incident=facing,
        cos_transmitted=cos_glue,
        index_incident=medium_index,
        index_transmitted=lens.glue_index,
    )
    radiance = lens.radiance(face_radius_squared=face_squared, sine_squared=sine_squared)
    per_area = radiance * transmittance * jnp.square(ratio) * facing / (normal_s * length_squared)
    out_meridian = (radius - cap_radius * cos) * per_length
    return BackwardRays(
        cone=opening / jnp.square(lens.sine_limit) - 1.0,
        face=face_squared / jnp.square(lens.face_radius) - 1.0,
        drop=jnp.maximum(rim_squared / jnp.square(lens.aperture_radius) - 1.0, -cos_medium),
        lateral=per_area * out_meridian,
        axial=per_area * out_s,
    )
