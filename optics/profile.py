"""Spot radius behind a lens: half maximum, isophote, equivalent cone.

All are for a plane perpendicular to the axis, where the irradiance is V_s.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from optics.irradiance_lookup import IrradianceTable, LensField

_REGRESSION_SAMPLES = 56
_AMBIGUITY_SAMPLES = 1200
_FIELD_SAMPLES = 1025

Light = IrradianceTable | LensField


class EffectiveCone(NamedTuple):
    """The cone d = kR + b that a regression fits to a lens (Zhou et al. 2020, eq. 1).

    Attributes:
        k: slope.
        b: apex offset, mm.
        half_angle: atan(1/k), rad.
        r_squared: R², the fraction of the variance of d that the cone explains.
    """

    k: Float[Array, ""]
    b: Float[Array, ""]
    half_angle: Float[Array, ""]
    r_squared: Float[Array, ""]


def half_maximum_radius(light: Light, *, distance: ArrayLike) -> Float[Array, "*batch"]:
    """Radius of the outermost circle on a plane with half of the plane's peak irradiance.

    Args:
        light: of a lens in a medium, as a table or by quadrature.
        distance: d, distance of the plane from the tip, mm.

    Returns:
        R, mm. The peak need not lie on the axis.
    """
    radius, irradiance = _profile(light, distance)
    half = 0.5 * jnp.max(irradiance, axis=-1, keepdims=True)
    return _outermost_crossing(radius, irradiance, half)


def isophote_radius(
    light: Light, *, distance: ArrayLike, level: ArrayLike
) -> Float[Array, "*batch"]:
    """Radius of the outermost circle on a plane with a given irradiance.

    Args:
        light: of a lens in a medium, as a table or by quadrature.
        distance: d, distance of the plane from the tip, mm.
        level: irradiance per unit power in the core, 1/mm², such as a camera's threshold.

    Returns:
        R, mm; 0 if the irradiance is below the level everywhere.
    """
    radius, irradiance = _profile(light, distance)
    return _outermost_crossing(radius, irradiance, jnp.asarray(level)[..., None])


def effective_cone(
    light: Light,
    *,
    from_distance: float,
    to_distance: float,
    level: ArrayLike | None = None,
) -> EffectiveCone:
    """Fit d = kR + b by least squares over evenly spaced distances (Zhou et al. 2020, eq. 1).

    Args:
        light: of a lens in a medium, as a table or by quadrature.
        from_distance: smallest d, mm.
        to_distance: largest d, mm.
        level: irradiance of the isophote with radius R, 1/mm² per unit power; None for the half
            maximum. Distances at which the irradiance is below it everywhere are left out.
    """
    distance = jnp.linspace(from_distance, to_distance, _REGRESSION_SAMPLES)
    if level is None:
        radius = half_maximum_radius(light, distance=distance)
    else:
        radius = isophote_radius(light, distance=distance, level=level)
    weight = (radius > 0.0) / jnp.sum(radius > 0.0)
    mean_radius, mean_distance = jnp.sum(weight * radius), jnp.sum(weight * distance)
    covariance = jnp.sum(weight * (radius - mean_radius) * (distance - mean_distance))
    radius_variance = jnp.sum(weight * jnp.square(radius - mean_radius))
    distance_variance = jnp.sum(weight * jnp.square(distance - mean_distance))
    k = covariance / radius_variance
    return EffectiveCone(
        k=k,
        b=mean_distance - k * mean_radius,
        half_angle=jnp.arctan(1.0 / k),
        r_squared=covariance**2 / (radius_variance * distance_variance),
    )


def ambiguous_distances(
    light: Light, *, from_distance: float, to_distance: float
) -> list[tuple[float, float]]:
    """Intervals of distances that share their half-maximum radius with another distance.

    Args:
        light: of a lens in a medium, as a table or by quadrature.
        from_distance: smallest d, mm.
        to_distance: largest d, mm.

    Returns:
        (first, last) of every interval, mm, at a resolution of 1200 samples; empty if every radius
        belongs to only one distance.
    """
    distance = np.linspace(from_distance, to_distance, _AMBIGUITY_SAMPLES)
    radius = np.asarray(half_maximum_radius(light, distance=jnp.asarray(distance)))
    low, high = np.minimum(radius[:-1], radius[1:]), np.maximum(radius[:-1], radius[1:])
    # A radius is ambiguous if more than one step of the curve R(d) passes it.
    middle = 0.5 * (low + high)
    passes = (low <= middle[:, None]) & (middle[:, None] < high)
    ambiguous = np.sum(passes, axis=1) > 1
    edges = np.flatnonzero(np.diff(np.concatenate([[0], ambiguous.astype(int), [0]])))
    return [(float(distance[first]), float(distance[last])) for first, last in edges.reshape(-1, 2)]


def _profile(light: Light, distance: ArrayLike) -> tuple[Array, Array]:
    """Radii (last axis) and irradiance on planes, at the columns of a table if there is one."""
    samples = light.values.shape[1] if isinstance(light, IrradianceTable) else _FIELD_SAMPLES
    distance = jnp.asarray(distance, dtype=float)[..., None]
    radius = light.envelope(distance) * np.linspace(0.0, 1.0, samples)
    return radius, light(radius=radius, distance=distance)[1]


@jax.jit
def _outermost_crossing(radius: Array, irradiance: Array, level: Array) -> Array:
    """Radius at which the profile finally falls below a level; 0 if it is never above it.

    Exact for a table, which is linear between its columns.
    """
    above = irradiance[..., :-1] >= level
    last = above.shape[-1] - 1 - jnp.argmax(above[..., ::-1], axis=-1, keepdims=True)

    def at(values, index):
        return jnp.take_along_axis(values, index, axis=-1)

    inner, outer = at(irradiance, last), at(irradiance, last + 1)
    fall = jnp.where(inner > outer, inner - outer, 1.0)
    share = jnp.clip((inner - level) / fall, 0.0, 1.0)
    crossing = at(radius, last) + share * (at(radius, last + 1) - at(radius, last))
    return jnp.where(jnp.any(above, axis=-1, keepdims=True), crossing, 0.0)[..., 0]
