"""Vector irradiance of a lens in a medium, as a table."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.typing import ArrayLike
from jaxtyping import Array, Bool, Float

from optics.emission import TRANSMITTED, emitted_rays
from optics.irradiance import vector_irradiance
from optics.lens import GlueLens

_NEAREST, _FARTHEST = 0.01, 24.0
_ROWS, _COLUMNS = 48, 96  # cells of the first grid, for which all points are computed
_DOUBLINGS = 4
_TOLERANCE = 3e-4  # of the row's peak; points with a larger interpolation error are refined
_BESIDE = 1e-9
"""Cells before a sample at which the next cell begins. Many points lie on a sample, and XLA may
compute their place twice with different rounding, so rounding must not decide on the cell there."""


class LensField(eqx.Module):
    """Light of a lens in a medium, by quadrature at every call: exact, differentiable, slow.

    Attributes:
        lens: the lens.
        medium_index: n0.
    """

    lens: GlueLens
    medium_index: ArrayLike

    def envelope(self, distance: ArrayLike) -> Float[Array, "*batch"]:
        """Radius outside which there is no light at a distance from the tip, mm.

        It has no derivative with respect to the lens, because that is infinite at the critical
        angle.

        Args:
            distance: s, mm.
        """
        contact_radius, slope = lax.stop_gradient(_envelope(self.lens, self.medium_index))
        return contact_radius + slope * jnp.asarray(distance)

    def __call__(
        self, *, radius: ArrayLike, distance: ArrayLike
    ) -> tuple[Float[Array, "*batch"], Float[Array, "*batch"]]:
        """V_rho and V_s, 1/mm² per unit power in the core (see `vector_irradiance`).

        Args:
            radius: distance from the axis, mm.
            distance: s, distance from the tip along the axis, mm.
        """
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

    # A NumPy array, as from a file, would be copied (19 MB) at every compiled call.
    values: Float[Array, "n_s n_rho 2"] = eqx.field(converter=jnp.asarray)
    medium_index: Float[Array, ""] = eqx.field(converter=jnp.asarray)
    contact_radius: Float[Array, ""] = eqx.field(converter=jnp.asarray)
    slope: Float[Array, ""] = eqx.field(converter=jnp.asarray)
    nearest: float = _NEAREST
    farthest: float = _FARTHEST

    def envelope(self, distance: ArrayLike) -> Float[Array, "*batch"]:
        """Radius outside which there is no light at a distance from the tip, mm.

        Args:
            distance: s, mm.
        """
        return self.contact_radius + self.slope * jnp.asarray(distance)

    def __call__(
        self, *, radius: ArrayLike, distance: ArrayLike
    ) -> tuple[Float[Array, "*batch"], Float[Array, "*batch"]]:
        """Look up V_rho and V_s, 1/mm² per unit power in the core.

        Args:
            radius: distance from the axis, mm.
            distance: s, distance from the tip along the axis, mm.
        """
        return _look_up(self, jnp.asarray(radius), jnp.asarray(distance))


@jax.jit
def _look_up(table: IrradianceTable, radius: Array, distance: Array) -> tuple[Array, Array]:
    radius, distance = jnp.broadcast_arrays(radius, distance)
    rows, columns, _ = table.values.shape
    envelope = table.envelope(distance)
    x = radius / envelope
    y = jnp.log(jnp.clip(distance, table.nearest, table.farthest) / table.nearest)
    column = jnp.clip(x, 0.0, 1.0) * (columns - 1)
    row = y / jnp.log(table.farthest / table.nearest) * (rows - 1)
    j = jnp.clip((column - _BESIDE).astype(int), 0, columns - 2)
    i = jnp.clip((row - _BESIDE).astype(int), 0, rows - 2)
    across, along = (column - j)[..., None], (row - i)[..., None]
    near = table.values[i, j] * (1.0 - across) + table.values[i, j + 1] * across
    far = table.values[i + 1, j] * (1.0 - across) + table.values[i + 1, j + 1] * across
    lit = (x <= 1.0) & (distance >= 0.0)
    scale = jnp.where(lit, 1.0 / jnp.square(envelope), 0.0)[..., None]
    field = (near * (1.0 - along) + far * along) * scale
    return field[..., 0], field[..., 1]


def irradiance_table(lens: GlueLens, *, medium_index: ArrayLike) -> IrradianceTable:
    """Tabulate the vector irradiance of a lens in a medium.

    Each refinement halves the cells. It computes new points only near points at which cubic
    interpolation from the coarser grid was wrong, so smooth light needs few points. This function
    cannot be traced; differentiate `vector_irradiance` or a `LensField` instead.

    Args:
        lens: the lens.
        medium_index: n0, refractive index of the medium.
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
            wanted = np.kron(_with_neighbours(wanted), np.ones((2, 2), dtype=bool))
            wanted = wanted[: rows + 1, : columns + 1]
            wanted[::2, ::2] = False
        distance = _NEAREST * (_FARTHEST / _NEAREST) ** np.linspace(0.0, 1.0, rows + 1)
        envelope = np.asarray(field.envelope(distance))
        row, column = np.nonzero(wanted)
        light = field(radius=envelope[row] * column / columns, distance=distance[row])
        computed = np.stack(light, axis=-1) * np.square(envelope[row])[:, None]
        error = np.max(np.abs(computed - values[row, column]), axis=-1)
        values[row, column] = computed
        wanted[row, column] = error > _TOLERANCE * np.max(values[..., 1], axis=1)[row]
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


def _with_neighbours(mask: Bool[np.ndarray, "n m"]) -> Bool[np.ndarray, "n m"]:
    """The mask and all adjacent points, including diagonal ones."""
    padded = np.pad(mask, 1)
    along = padded[:-2] | padded[1:-1] | padded[2:]
    return along[:, :-2] | along[:, 1:-1] | along[:, 2:]


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
