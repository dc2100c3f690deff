"""Power that leaves the cap."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from optics._emission import emitted_rays
from optics._lens import GlueLens

_AREAS, _SINES, _TURNS = 64, 48, 48


def transmitted_power(lens: GlueLens, *, medium_index: ArrayLike) -> Float[Array, ""]:
    r"""Part of the core's power that passes the cap at its first try.

    $\int L\,T\cos\theta\,d\Omega\,dA$ over the core's face and its cone: Gauss-Legendre in
    $r^2$ and $\sin^2\theta$, the midpoint rule in the angle between the two, which is periodic.

    Args:
        lens: the lens.
        medium_index: n0, refractive index of the medium.

    Returns:
        Between 0 and 1: Fresnel losses, total internal reflection and the drop's side taken off.
    """
    nodes, weights = np.polynomial.legendre.leggauss(_AREAS)
    area, area_weight = 0.5 * (nodes + 1.0), 0.5 * weights
    nodes, weights = np.polynomial.legendre.leggauss(_SINES)
    spread, spread_weight = 0.5 * (nodes + 1.0), 0.5 * weights
    turn = (np.arange(_TURNS) + 0.5) * np.pi / _TURNS  # the other half is its mirror image
    r, sine, angle = jnp.meshgrid(
        lens.core_radius * np.sqrt(area), lens.sine_limit * np.sqrt(spread), turn, indexing="ij"
    )
    rays = emitted_rays(
        lens,
        medium_index=medium_index,
        points=jnp.stack([r, jnp.zeros_like(r)], axis=-1),
        directions=jnp.stack([sine * jnp.cos(angle), sine * jnp.sin(angle)], axis=-1),
    )
    radiance = lens.radiance(face_radius_squared=jnp.square(r), sine_squared=jnp.square(sine))
    weight = jnp.broadcast_to(
        radiance * area_weight[:, None, None] * spread_weight[:, None], rays.transmittance.shape
    )
    return jnp.sum(weight * rays.transmittance) / jnp.sum(weight)
