"""Refraction and Fresnel transmission at a smooth boundary between two media."""

import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import Array, Bool, Float

MEDIA = {"air": 1.0, "water": 1.333, "vitreous": 1.336}
"""Refractive index by name, visible light; vitreous as in Gullstrand's schematic eye."""


def refracted_cosine(*, cos_incident: ArrayLike, index_ratio: ArrayLike) -> Float[Array, "*batch"]:
    r"""Cosine of the refraction angle, 0 under total internal reflection.

    $\cos\theta_t = \sqrt{1 - m^2 (1 - \cos^2\theta_i)}$ with $m = n_i/n_t$ (Snell's law), the
    index on the incident side over that on the other. Under total internal reflection its
    derivative is 0, too.
    """
    squared = 1.0 - jnp.square(index_ratio) * (1.0 - jnp.square(cos_incident))
    refracts = squared > 0.0
    # The root's derivative is infinite at 0, so 0 must not enter the root at all.
    return jnp.where(refracts, jnp.sqrt(jnp.where(refracts, squared, 1.0)), 0.0)


def fresnel_transmittance(
    *,
    cos_incident: ArrayLike,
    cos_transmitted: ArrayLike,
    index_incident: ArrayLike,
    index_transmitted: ArrayLike,
) -> Float[Array, "*batch"]:
    r"""Fraction of the power of unpolarised light that passes a smooth boundary.

    $T = 1 - (r_s^2 + r_p^2)/2$ (Fresnel; Born & Wolf, Principles of Optics, §1.5.2). The same for
    a ray and its reverse.

    Args:
        cos_incident: cosine of the angle of incidence, in [0, 1].
        cos_transmitted: cosine of the angle of refraction, 0 under total internal reflection.

    Returns:
        T in [0, 1]; 0 under total internal reflection.
    """
    s_in, s_out = index_incident * cos_incident, index_transmitted * cos_transmitted
    p_in, p_out = index_transmitted * cos_incident, index_incident * cos_transmitted
    # 1 - r^2 = 4ab/(a + b)^2 is accurate near grazing exit, where r tends to 1. The floor avoids
    # 0/0 for grazing incidence between equal media.
    floor = jnp.finfo(float).tiny
    s_sum = jnp.maximum(jnp.square(s_in + s_out), floor)
    p_sum = jnp.maximum(jnp.square(p_in + p_out), floor)
    return jnp.asarray(2.0 * (s_in * s_out / s_sum + p_in * p_out / p_sum))


def refract(
    *,
    direction: Float[Array, "*batch 3"],
    normal: Float[Array, "*batch 3"],
    index_incident: ArrayLike,
    index_transmitted: ArrayLike,
) -> tuple[Float[Array, "*batch 3"], Float[Array, "*batch"], Bool[Array, "*batch"]]:
    r"""Refract unit directions at a boundary whose normal points along the light.

    $n_t\mathbf t = n_i\mathbf d + (n_t\cos\theta_t - n_i\cos\theta_i)\mathbf n$ (Snell's law as a
    vector; Born & Wolf §3.2.2).

    Args:
        direction: **d**, unit vectors of the incident light.
        normal: **n**, unit normals with **d**·**n** > 0.
        index_incident: refractive index before the boundary; one, or one for each ray.
        index_transmitted: refractive index behind it.

    Returns:
        Unit directions behind the boundary, Fresnel transmittance, and whether the light passes.
        Under total internal reflection the direction is along the boundary.
    """
    cos_incident = jnp.sum(direction * normal, axis=-1)
    ratio = jnp.broadcast_to(jnp.asarray(index_incident) / index_transmitted, cos_incident.shape)
    passes = jnp.square(ratio) * (1.0 - jnp.square(cos_incident)) < 1.0
    cos_transmitted = refracted_cosine(cos_incident=cos_incident, index_ratio=ratio)
    along = cos_transmitted - ratio * cos_incident
    bent = ratio[..., None] * direction + along[..., None] * normal
    bent = bent / jnp.linalg.norm(bent, axis=-1, keepdims=True)
    transmittance = fresnel_transmittance(
        cos_incident=cos_incident,
        cos_transmitted=cos_transmitted,
        index_incident=index_incident,
        index_transmitted=index_transmitted,
    )
    return bent, transmittance, passes
