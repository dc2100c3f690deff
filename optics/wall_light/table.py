r"""The light of a lens on a grid, to first order in the lens's parameters.

The vector irradiance V has no sources between the lens and the wall, and it is symmetric about the
beam. So the light through any patch is a line integral around its border (Stokes' stream function),

$$ \Phi = \tfrac12 \oint M(\rho, s)\,\mathbf u \cdot (\boldsymbol\rho \times d\mathbf l),
   \qquad M = \frac{1}{\pi\rho^2} \int_0^\rho V_s\,2\pi\rho'\,d\rho', $$

with the mean M of V_s over the disc of radius rho around the beam u. M is continuous where V jumps,
as at a sharp image of the core, and no light is lost between patches.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Float, ScalarLike

import optics
from optics.wall_light.cells import Sides
from optics.wall_light.pixel_light import off_axis_part


class Grid(NamedTuple):
    """Positions of a table's samples.

    Attributes:
        contact_radius, slope: envelope of the light, mm and 1.
        nearest, farthest: distances from the tip of its first and last row, mm.
    """

    contact_radius: ScalarLike
    slope: ScalarLike
    nearest: ScalarLike
    farthest: ScalarLike


class LensTable(eqx.Module):
    """Mean light within a radius, to first order in the lens's parameters, cubic between samples.

    Rows are uniform in ln s, columns in rho / e(s), with the envelope e(s); samples are M e(s)².

    Attributes:
        values: samples at the parameters `at`.
        slopes: derivatives of the samples with respect to each parameter.
        transmitted_value: fraction of the power that leaves the cap.
        transmitted_slopes: its derivatives.
        at: parameters for which the table was computed.
        moved: difference of the current parameters from `at`.
        grid: positions of the samples.
    """

    values: Float[Array, "rows columns"]
    slopes: Float[Array, "p rows columns"]
    transmitted_value: Float[Array, ""]
    transmitted_slopes: Float[Array, "p"]
    at: Float[Array, "p"]
    moved: Float[Array, "p"]
    grid: Grid

    def __call__(
        self, *, radius: Float[Array, "*n"], distance: Float[Array, "*n"]
    ) -> Float[Array, "*n"]:
        """M, 1/mm² per unit power; 0 behind the tip."""
        rows, columns = self.values.shape
        envelope = self.grid.contact_radius + self.grid.slope * distance
        x = radius / envelope
        reached = jnp.clip(distance, self.grid.nearest, self.grid.farthest)
        y = jnp.log(reached / self.grid.nearest) / jnp.log(self.grid.farthest / self.grid.nearest)
        column = jnp.clip(x, 0.0, 1.0) * (columns - 1)
        mean = _interpolated(self.values, self.slopes, self.moved, y * (rows - 1), column)
        # A disc that is larger than the envelope has all the light too.
        scale = jnp.square(envelope * jnp.maximum(x, 1.0))
        return jnp.where(distance > 0.0, mean / scale, 0.0)

    def through(
        self, sides: Sides, *, tip: Float[Array, "3"], axis: Float[Array, "3"]
    ) -> Float[Array, "..."]:
        """Light between each side and the axis, per unit power."""
        return jnp.sum(self.passing(sides.node, sides.step, tip=tip, axis=axis), axis=-1)

    def passing(
        self,
        point: Float[Array, "... 3"],
        step: Float[Array, "... 3"],
        *,
        tip: Float[Array, "3"],
        axis: Float[Array, "3"],
    ) -> Float[Array, "..."]:
        """The line integral's part of a step at a point of the wall, both mm, per unit power."""
        offset = point - tip
        lateral = off_axis_part(offset, axis)
        radius = jnp.sqrt(optics.dot(lateral, lateral) + 1e-24)
        swept = optics.dot(jnp.cross(axis, lateral), step)
        return 0.5 * self(radius=radius, distance=optics.dot(offset, axis)) * swept

    def changed(self, by: Float[Array, "p"]) -> LensTable:
        """The table with the lens's parameters changed."""
        return eqx.tree_at(lambda table: table.moved, self, self.moved + by)

    def arrays(self) -> dict[str, Any]:
        """All that `of_arrays` needs, by name."""
        own = {name: getattr(self, name) for name in self.__dataclass_fields__ if name != "grid"}
        return {name: np.asarray(part) for name, part in (own | self.grid._asdict()).items()}

    @classmethod
    def of_arrays(cls, kept: Mapping[str, ArrayLike]) -> LensTable:
        """A table from its `arrays`."""
        arrays = {name: jnp.asarray(part) for name, part in kept.items()}
        grid = Grid(*(arrays.pop(name) for name in Grid._fields))
        return cls(**arrays, grid=grid)

    def transmitted(self) -> Float[Array, ""]:
        """Fraction of the power that leaves the cap."""
        return self.transmitted_value + jnp.dot(self.moved, self.transmitted_slopes)


@jax.custom_jvp
def _interpolated(
    values: Float[Array, "rows columns"],
    slopes: Float[Array, "p rows columns"],
    moved: Float[Array, "p"],
    row: Float[Array, "*n"],
    column: Float[Array, "*n"],
) -> Float[Array, "*n"]:
    """The mean light at positions between samples."""
    return _at(values, slopes, moved, row, column, gradient=False)[0]


@_interpolated.defjvp
def _interpolated_slope(primals, tangents):
    """Derivative for constant samples.

    By JAX's own rules each direction would interpolate again, which is four times as slow.
    """
    value, by_row, by_column, *by_moved = _at(*primals, gradient=True)
    _, _, moved, row, column = tangents
    slope = by_row * row + by_column * column
    return value, slope + sum(moved[k] * field for k, field in enumerate(by_moved))


def _at(
    values: Array, slopes: Array, moved: Array, row: Array, column: Array, *, gradient: bool
) -> list[Float[Array, "*n"]]:
    """The mean light, and with `gradient` its derivatives by row, column and `moved`."""
    rows, columns = values.shape
    i, down, steps_down = _taps(row, rows)
    j, across, steps_across = _taps(column, columns)
    samples = values + jnp.tensordot(moved, slopes, 1)
    found: list[Any] = [0.0] * (3 + len(slopes))
    for r in range(4):
        for c in range(4):
            at = (i + r) * columns + j + c
            light, weight = samples.ravel()[at], down[r] * across[c]
            added = [weight * light]
            if gradient:
                added += [steps_down[r] * across[c] * light, down[r] * steps_across[c] * light]
                added += [weight * field.ravel()[at] for field in slopes]
            found = [old + new for old, new in zip(found, added, strict=False)]
    return found


def _taps(place: Array, count: int) -> tuple[Array, tuple[Array, ...], tuple[Array, ...]]:
    """First of the four samples around a position; weights of their cubic and of its slope."""
    first = jnp.clip(place.astype(int) - 1, 0, count - 4)
    t = place - first
    weights = (
        (t - 1) * (t - 2) * (t - 3) / -6,
        t * (t - 2) * (t - 3) / 2,
        t * (t - 1) * (t - 3) / -2,
        t * (t - 1) * (t - 2) / 6,
    )
    slopes = (
        (3 * t * t - 12 * t + 11) / -6,
        (3 * t * t - 10 * t + 6) / 2,
        (3 * t * t - 8 * t + 3) / -2,
        (3 * t * t - 6 * t + 2) / 6,
    )
    return first, weights, slopes
