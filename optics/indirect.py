"""Light that a Lambertian eyeball scatters back onto its own wall."""

from __future__ import annotations

import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float


def indirect_irradiance(
    *,
    flux: ArrayLike,
    reflectance: ArrayLike,
    eye_radius: ArrayLike,
    pupil_radius: ArrayLike = 0.0,
) -> Float[Array, "*batch"]:
    r"""Indirect irradiance in a sphere with a uniform Lambertian wall, the same everywhere.

    $E = \rho\Phi / (4\pi r^2 (1-\rho(1-f)))$ with $f = (1 - \sqrt{1 - p^2/r^2})/2$, the fraction of
    the sphere's area that the pupil takes (integrating sphere with a port: Jacquez & Kuppenheim
    1955). Each reflection spreads light uniformly over the sphere, and light through the pupil is
    lost, so the sum over reflections is geometric. The formula neglects the instrument's shadow and
    absorption, and any variation of the reflectance around its flux-weighted mean.

    Args:
        flux: power that reaches the wall directly, W.
        reflectance: rho in [0, 1), one value or one per colour channel.
        eye_radius: r, mm.
        pupil_radius: p, radius of the pupil's rim, mm, in [0, r); 0 is closed.

    Returns:
        Irradiance, W/mm^2.

    Example:
        >>> even = indirect_irradiance(flux=1.0, reflectance=0.5, eye_radius=11.5)
        >>> round(float(even), 6)  # W/mm^2
        0.000602
    """
    rho = jnp.asarray(reflectance)
    radius = jnp.asarray(eye_radius)
    opening = 0.5 * (1.0 - jnp.sqrt(1.0 - jnp.square(pupil_radius / radius)))
    return rho * flux / (4.0 * jnp.pi * jnp.square(radius) * (1.0 - rho * (1.0 - opening)))
