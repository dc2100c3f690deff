"""Light behind a lens: rays and their power, vector irradiance as a table, and the spot's radius.

Radii (half maximum, isophote, equivalent cone) are for a plane perpendicular to the axis, where the
irradiance is V_s.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.typing import ArrayLike
from jaxtyping import Array, Float, Int
from scipy.ndimage import binary_dilation

from eyespot.optics.irradiance import vector_irradiance
from eyespot.optics.irradiance_edges import implicit_root, scan_boundaries, settle
from eyespot.optics.lens import GlueLens
from eyespot.optics.refraction import refract

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
        points: start points on the core's face, mm from its centre.
        directions: components of the directions perpendicular to the axis, inside the glue. Their
            length is the sine of the angle to the axis, at most NA/n_g for light of the core.
    """
    point, normal, direction, meets = _meet_cap(lens, points, directions)
    hits = meets & (jnp.sum(point[..., :2] ** 2, axis=-1) <= jnp.square(lens.aperture_radius))
    direction, transmittance, passes = refract(
        direction=direction,
        normal=jnp.where(hits[..., None], normal, jnp.array([0.0, 0.0, 1.0])),
        index_incident=lens.glue_index,
        index_transmitted=medium_index,
    )
    at_cap = jnp.where(passes, TRANSMITTED, TOTAL_INTERNAL_REFLECTION)
    status = jnp.where(hits, at_cap, MISSED_APERTURE)
    transmittance = jnp.where(status == TRANSMITTED, transmittance, 0.0)
    return EmittedRays(point, direction, transmittance, status)


@jax.jit
def transmitted_power(lens: GlueLens, *, medium_index: ArrayLike) -> Float[Array, ""]:
    r"""Fraction of the core's power that leaves the cap without a reflection.

    $\Phi = \int\!\!\int L\,T\,d^2p\,d^2q$ over the core's face and the two components **q** of the
    direction perpendicular to the axis, with the Fresnel transmittance T. The other light is
    reflected into the glue or meets the side of the drop.
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
        point, normal, ray, meets = _meet_cap(lens, place(height), direction)
        sine_in = 1.0 - jnp.square(jnp.sum(ray * normal, axis=-1))
        sine_out = jnp.square(lens.glue_index / jnp.asarray(medium_index)) * sine_in
        rim = jnp.sum(point[..., :2] ** 2, axis=-1) / lens.aperture_radius**2
        return jnp.where(meets, jnp.maximum(sine_out, rim), 2.0) - 1.0

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


def _meet_cap(
    lens: GlueLens, points: Array, directions: Array
) -> tuple[Float[Array, "*batch 3"], Float[Array, "*batch 3"], Float[Array, "*batch 3"], Array]:
    """Where rays from the core's face meet the cap's sphere: points, and its unit normals there.

    Then the rays' unit directions, and whether they meet the sphere's upper half, as the cap is.
    """
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
    return point, normal, direction, meets & (normal[..., 2] > 0.0)


_NEAREST, _FARTHEST = 0.01, 24.0
_ROWS, _COLUMNS = 96, 96
"""Cells of the first grid, for which all points are computed. A sharp image's edge crosses columns
from row to row, and a look-up between two rows blurs it: with half the rows, images near a focus
missed up to 0.26 % of their peak, with these 0.08 %."""
_DOUBLINGS = 4
_INTERPOLATION_TOLERANCE = 3e-4
"""Interpolation error over the row's peak above which a point is refined."""
_BESIDE = 1e-9
"""Cells before a sample at which the next cell begins. Many points lie on a sample, and XLA may
compute their place twice with different rounding, so rounding must not decide on the cell there."""


class LensField(eqx.Module):
    """Light of a lens in a medium, by quadrature at every call: exact, differentiable, slow."""

    lens: GlueLens
    medium_index: ArrayLike

    def envelope(self, distance: ArrayLike) -> Float[Array, "*batch"]:
        """Radius outside which there is no light at a distance s (mm) from the tip, mm.

        It has no derivative with respect to the lens, because that is infinite at the critical
        angle.
        """
        contact_radius, slope = lax.stop_gradient(_envelope(self.lens, self.medium_index))
        return contact_radius + slope * jnp.asarray(distance)

    def __call__(
        self, *, radius: ArrayLike, distance: ArrayLike
    ) -> tuple[Float[Array, "*batch"], Float[Array, "*batch"]]:
        """V_rho and V_s, with arguments and results as those of `vector_irradiance`."""
        return vector_irradiance(
            self.lens, medium_index=self.medium_index, radius=radius, distance=distance
        )


class IrradianceTable(eqx.Module):
    r"""Vector irradiance on a grid that widens with the beam.

    With the envelope $e(s) = \mathrm{contact\_radius} + \mathrm{slope}\,s$, outside which there is
    no light, the grid is even in

        x = rho / e(s)                                  in [0, 1],
        y = ln(s / nearest) / ln(farthest / nearest)    in [0, 1], clipped,

    and its values are $\mathbf V e(s)^2$, which hardly depend on s far from the lens. Sample
    (i, j, c) belongs to y = i/(n_s - 1), x = j/(n_rho - 1) and to V_rho for c = 0, V_s for c = 1.
    A look-up is bilinear in (y, x), divided by e(s)²; it is 0 for x > 1 and for s < 0. Nearer than
    `nearest` the first row is used, farther than `farthest` the last one, with their own e(s).

    Attributes:
        values: V e², per unit power in the core, without unit.
        medium_index: n0.
        contact_radius: radius of the envelope at the tip, mm.
        slope: growth of the envelope's radius per distance.
        nearest: distance of the first row, mm.
        farthest: distance of the last row, mm.
    """

    # A NumPy array, as from a file, would be copied (38 MB) at every compiled call.
    values: Float[Array, "n_s n_rho 2"] = eqx.field(converter=jnp.asarray)
    medium_index: Float[Array, ""] = eqx.field(converter=jnp.asarray)
    contact_radius: Float[Array, ""] = eqx.field(converter=jnp.asarray)
    slope: Float[Array, ""] = eqx.field(converter=jnp.asarray)
    nearest: float = _NEAREST
    farthest: float = _FARTHEST

    def envelope(self, distance: ArrayLike) -> Float[Array, "*batch"]:
        """Radius outside which there is no light at a distance s (mm) from the tip, mm."""
        return self.contact_radius + self.slope * jnp.asarray(distance)

    @jax.jit
    def __call__(
        self, *, radius: ArrayLike, distance: ArrayLike
    ) -> tuple[Float[Array, "*batch"], Float[Array, "*batch"]]:
        """Look up V_rho and V_s, with arguments and results as those of `vector_irradiance`."""
        radius, distance = jnp.broadcast_arrays(radius, distance)
        rows, columns, _ = self.values.shape
        envelope = self.envelope(distance)
        x = radius / envelope
        y = jnp.log(jnp.clip(distance, self.nearest, self.farthest) / self.nearest)
        column = jnp.clip(x, 0.0, 1.0) * (columns - 1)
        row = y / jnp.log(self.farthest / self.nearest) * (rows - 1)
        j = jnp.clip((column - _BESIDE).astype(int), 0, columns - 2)
        i = jnp.clip((row - _BESIDE).astype(int), 0, rows - 2)
        across, along = (column - j)[..., None], (row - i)[..., None]
        near = self.values[i, j] * (1.0 - across) + self.values[i, j + 1] * across
        far = self.values[i + 1, j] * (1.0 - across) + self.values[i + 1, j + 1] * across
        lit = (x <= 1.0) & (distance >= 0.0)
        scale = jnp.where(lit, 1.0 / jnp.square(envelope), 0.0)[..., None]
        field = (near * (1.0 - along) + far * along) * scale
        return field[..., 0], field[..., 1]


def irradiance_table(lens: GlueLens, *, medium_index: ArrayLike) -> IrradianceTable:
    """Tabulate the vector irradiance of a lens in a medium.

    Each refinement halves the cells. It computes new points only near points at which cubic
    interpolation from the coarser grid was wrong, so smooth light needs few points. This function
    cannot be traced; differentiate `vector_irradiance` or a `LensField` instead.
    """
    field = LensField(lens, medium_index)
    contact_radius = field.envelope(0.0)
    slope = field.envelope(1.0) - contact_radius
    rows, columns = _ROWS, _COLUMNS
    values = np.zeros((rows + 1, columns + 1, 2))
    wanted = np.ones((rows + 1, columns + 1), dtype=bool)
    for doubling in range(_DOUBLINGS + 1):
        if doubling > 0:
            rows, columns = 2 * rows, 2 * columns
            values = _halved(_halved(values, axis=0), axis=1)
            close = binary_dilation(wanted, np.ones((3, 3)))
            wanted = np.kron(close, np.ones((2, 2), dtype=bool))
            wanted = wanted[: rows + 1, : columns + 1]
            wanted[::2, ::2] = False
        distance = _NEAREST * (_FARTHEST / _NEAREST) ** np.linspace(0.0, 1.0, rows + 1)
        envelope = np.asarray(field.envelope(distance))
        row, column = np.nonzero(wanted)
        light = field(radius=envelope[row] * column / columns, distance=distance[row])
        computed = np.stack(light, axis=-1) * np.square(envelope[row])[:, None]
        error = np.max(np.abs(computed - values[row, column]), axis=-1)
        values[row, column] = computed
        wanted[row, column] = error > _INTERPOLATION_TOLERANCE * np.max(values[..., 1], axis=1)[row]
    return IrradianceTable(
        values=jnp.asarray(values),
        medium_index=jnp.asarray(medium_index, dtype=float),
        contact_radius=contact_radius,
        slope=slope,
    )


def _halved(values: Float[np.ndarray, "*shape"], *, axis: int) -> Float[np.ndarray, "*finer"]:
    """The values, with their cubic interpolants at half steps along an axis."""
    values = np.moveaxis(values, axis, 0)
    before = 3.0 * values[:1] - 3.0 * values[1:2] + values[2:3]
    after = 3.0 * values[-1:] - 3.0 * values[-2:-1] + values[-3:-2]
    padded = np.concatenate([before, values, after])
    finer = np.empty((2 * len(values) - 1, *values.shape[1:]))
    finer[::2] = values
    finer[1::2] = (9.0 * (padded[1:-2] + padded[2:-1]) - padded[:-3] - padded[3:]) / 16.0
    return np.moveaxis(finer, 0, axis)


@jax.jit
def _envelope(lens: GlueLens, medium_index) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """Contact radius and slope of a cone outside which there is no light.

    Rays in a meridional plane are enough: a skew ray with the same height and angle stays nearer
    to the axis.
    """
    share = np.linspace(-1.0, 1.0, 401)
    height, sine = jnp.meshgrid(share * lens.face_radius, share * lens.sine_limit)
    across = jnp.zeros_like(height)
    rays = emitted_rays(
        lens,
        medium_index=medium_index,
        points=jnp.stack([height, across], axis=-1),
        directions=jnp.stack([sine, across], axis=-1),
    )
    passed = rays.status == TRANSMITTED
    steepness = rays.direction[..., 0] / jnp.maximum(rays.direction[..., 2], 1e-3)
    at_tip = rays.point[..., 0] - steepness * rays.point[..., 2]
    at_tip, steepness = (jnp.where(passed, jnp.abs(x), 0.0) for x in (at_tip, steepness))
    return jnp.max(at_tip), jnp.max(steepness)


_REGRESSION_SAMPLES = 56
_AMBIGUITY_SAMPLES = 1200
_FIELD_SAMPLES = 129
"""Of a profile by quadrature. The two steps round the peak and the one of the crossing are looked
at more closely, at `_CLOSER` times as many radii: in 256 profiles of drawn lenses, each result was
that of as many all over."""
_CLOSER = 8

Light = IrradianceTable | LensField
"""Light of a lens in a medium, as a table or by quadrature."""


class EffectiveCone(NamedTuple):
    """The cone d = kR + b that a regression fits to a lens (Zhou et al. 2020, eq. 1).

    Attributes:
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
        distance: d, distance of the plane from the tip, mm.

    Returns:
        R, mm. The peak need not lie on the axis.
    """
    return _outermost_radius(light, distance)


def isophote_radius(
    light: Light, *, distance: ArrayLike, level: ArrayLike
) -> Float[Array, "*batch"]:
    """Radius of the outermost circle on a plane with a given irradiance.

    Args:
        distance: d, distance of the plane from the tip, mm.
        level: irradiance per unit power in the core, 1/mm², such as a camera's threshold.

    Returns:
        R, mm; 0 if the irradiance is below the level everywhere.
    """
    return _outermost_radius(light, distance, jnp.asarray(level)[..., None])


def effective_cone(light: Light, *, from_distance: float, to_distance: float) -> EffectiveCone:
    """Fit d = kR + b to half-maximum radii R by least squares (Zhou et al. 2020, eq. 1).

    Over evenly spaced distances d, mm; those without light are left out.
    """
    distance = jnp.linspace(from_distance, to_distance, _REGRESSION_SAMPLES)
    radius = half_maximum_radius(light, distance=distance)
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
    """Intervals of distances (mm) that share their half-maximum radius with another distance.

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


def _outermost_radius(light: Light, distance: ArrayLike, level: Array | None = None) -> Array:
    """Radius on planes at which the light finally falls below a level, or half of its peak."""
    distance = jnp.asarray(distance, dtype=float)[..., None]

    def profile(share: np.ndarray | Array) -> tuple[Array, Array]:
        """Radii (last axis), from shares of the envelope, and their irradiance."""
        radius = light.envelope(distance) * share
        return radius, light(radius=radius, distance=distance)[1]

    if isinstance(light, IrradianceTable):  # linear between its columns
        radius, irradiance = profile(np.linspace(0.0, 1.0, light.values.shape[1]))
        peak = jnp.max(irradiance, axis=-1, keepdims=True)
        return _outermost_crossing(radius, irradiance, 0.5 * peak if level is None else level)
    step = 1.0 / (_FIELD_SAMPLES - 1)
    closer = np.linspace(0.0, step, _CLOSER + 1)
    radius, irradiance = profile(np.linspace(0.0, 1.0, _FIELD_SAMPLES))
    if level is None:
        before = jnp.argmax(irradiance, axis=-1, keepdims=True) - 1.0
        around = jnp.abs(step * before + np.concatenate([closer, step + closer]))
        level = 0.5 * jnp.max(profile(around)[1], axis=-1, keepdims=True)
    start = _outermost_crossing(radius, irradiance, level)[..., None] / light.envelope(distance)
    start = step * jnp.floor(lax.stop_gradient(start) / step)
    return _outermost_crossing(*profile(start + closer), level)


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
