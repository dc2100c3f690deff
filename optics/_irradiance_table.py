"""Vector irradiance of a lens in a medium, tabulated for look-up."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from optics._emission import TRANSMITTED, emitted_rays
from optics._irradiance import vector_irradiance
from optics._lens import GlueLens

_NEAREST, _FARTHEST = 0.01, 24.0
_DISTANCES, _RADII = 192, 384


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

    values: Float[Array, "n_s n_rho 2"]
    medium_index: Float[Array, ""]
    contact_radius: Float[Array, ""]
    slope: Float[Array, ""]
    nearest: float = _NEAREST
    farthest: float = _FARTHEST

    def envelope(self, distance: ArrayLike) -> Float[Array, "*batch"]:
        """Radius of the beam's outermost light at a distance from the tip, mm.

        Args:
            distance: s, mm.
        """
        return self.contact_radius + self.slope * jnp.asarray(distance)

    def distances(self) -> Float[Array, "n_s"]:
        """Distances of the rows, mm."""
        share = np.linspace(0.0, 1.0, self.values.shape[0])
        return self.nearest * (self.farthest / self.nearest) ** share

    def __call__(
        self, *, radius: ArrayLike, distance: ArrayLike
    ) -> tuple[Float[Array, "*batch"], Float[Array, "*batch"]]:
        """Look up V_rho and V_s, 1/mm² per unit power in the core.

        Args:
            radius: distance from the axis, mm.
            distance: s, distance from the tip along the axis, mm.
        """
        radius, distance = jnp.broadcast_arrays(jnp.asarray(radius), jnp.asarray(distance))
        rows, columns, _ = self.values.shape
        envelope = self.envelope(distance)
        x = radius / envelope
        y = jnp.log(jnp.clip(distance, self.nearest, self.farthest) / self.nearest)
        column = jnp.clip(x, 0.0, 1.0) * (columns - 1)
        row = y / np.log(self.farthest / self.nearest) * (rows - 1)
        j = jnp.clip(column.astype(int), 0, columns - 2)
        i = jnp.clip(row.astype(int), 0, rows - 2)
        across, along = (column - j)[..., None], (row - i)[..., None]
        near = self.values[i, j] * (1.0 - across) + self.values[i, j + 1] * across
        far = self.values[i + 1, j] * (1.0 - across) + self.values[i + 1, j + 1] * across
        lit = (x <= 1.0) & (distance >= 0.0)
        scale = jnp.where(lit, 1.0 / jnp.square(envelope), 0.0)[..., None]
        field = (near * (1.0 - along) + far * along) * scale
        return field[..., 0], field[..., 1]


def irradiance_table(lens: GlueLens, *, medium_index: ArrayLike) -> IrradianceTable:
    """Tabulate the vector irradiance of a lens in a medium.

    Args:
        lens: the lens.
        medium_index: n0, refractive index of the medium.
    """
    contact_radius, slope = _envelope(lens, medium_index)
    table = IrradianceTable(
        values=jnp.zeros((_DISTANCES, _RADII, 2)),
        medium_index=jnp.asarray(medium_index, dtype=float),
        contact_radius=contact_radius,
        slope=slope,
    )
    distance = table.distances()[:, None]
    envelope = table.envelope(distance)
    radius = envelope * np.linspace(0.0, 1.0, _RADII)
    field = vector_irradiance(lens, medium_index=medium_index, radius=radius, distance=distance)
    values = jnp.stack(field, axis=-1) * jnp.square(envelope)[..., None]
    return eqx.tree_at(lambda t: t.values, table, values)


@jax.jit
def _envelope(lens: GlueLens, medium_index) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """Contact radius and slope of a cone outside which no light of the first passage is found.

    From rays in a meridian plane: a skew ray of the same height and angle stays nearer the axis.
    """
    share = np.linspace(-1.0, 1.0, 401)
    height, sine = jnp.meshgrid(share * lens.core_radius, share * lens.sine_limit)
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
    return tuple(jnp.max(jnp.where(passed, jnp.abs(value), 0.0)) for value in (at_tip, steepness))
