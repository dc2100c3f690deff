"""Light that a closed matt eyeball scatters back onto its own wall."""

from __future__ import annotations

import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float


def indirect_irradiance(
    *, flux: ArrayLike, reflectance: ArrayLike, eye_radius: ArrayLike
) -> Float[Array, "*batch"]:
    r"""Indirect irradiance in a closed sphere with a uniform matt wall, the same everywhere.

    $E = \rho\Phi / (4\pi r^2 (1-\rho))$ (the integrating sphere: Jacquez & Kuppenheim 1955). Each
    bounce spreads its light evenly over the sphere, so the sum over bounces is geometric. It leaves
    out the pupil's opening (2.5 % for 3 mm radius at rho = 0.6), the instrument's shadow and
    absorption, and uneven reflectance beyond its flux-weighted mean.

    Args:
        flux: light that reaches the wall directly, W.
        reflectance: rho in [0, 1), one value or one per colour channel.
        eye_radius: r, mm.

    Returns:
        Irradiance, W/mm^2.
    """
    rho = jnp.asarray(reflectance)
    return rho * flux / (4.0 * jnp.pi * jnp.square(eye_radius) * (1.0 - rho))
