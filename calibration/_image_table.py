"""The light of a lens near some parameters: vector irradiance and its slopes on a small grid.

Quadrature at every pixel would take minutes a frame. A grid over the distances and radii that the
frames show takes seconds, slopes in the lens's parameters with it, and is made anew wherever the
fit has moved to.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, ScalarLike

import optics

PARAMETERS = (
    "core_radius",
    "aperture_radius",
    "rim_height",
    "sag",
    "glue_index",
    "numerical_aperture",
)
"""A lens's shape and light; `rim_height` is that of the cap's rim over the core, mm, so that a
drop stays possible when its sag alone moves."""

_ROWS, _COLUMNS = 48, 192
"""Behind the dome in vitreous, whose caustics move through the columns, off by up to 1.8 % of the
peak at 1.6 to 2 mm; with 24 rows by 3.9 %, with 96 by 0.9. In air it needs none of them."""
_BATCH = 64  # as in optics._irradiance: what so many points need stays in the cache


class Grid(NamedTuple):
    """Where a table has its samples.

    Attributes:
        contact_radius, slope: of the envelope within which there is light, mm and 1.
        nearest, farthest: distances from the tip of its first and last row, mm.
    """

    contact_radius: ScalarLike
    slope: ScalarLike
    nearest: ScalarLike
    farthest: ScalarLike


class LensTable(eqx.Module):
    """Vector irradiance, to first order in the lens's parameters, cubic between its samples.

    Rows are even in ln s, columns in rho / e(s); samples are V e(s)², as in
    `optics.IrradianceTable`.

    Attributes:
        values: at the parameters that the table was made for.
        slopes: per parameter.
        transmitted_value: part of the power that leaves the cap.
        transmitted_slopes: per parameter.
        moved: of the parameters since; 0 where the values are exact.
        grid: where the samples are.
    """

    values: Float[Array, "rows columns 2"]
    slopes: Float[Array, "p rows columns 2"]
    transmitted_value: Float[Array, ""]
    transmitted_slopes: Float[Array, "p"]
    moved: Float[Array, "p"]
    grid: Grid

    def __call__(
        self, *, radius: Float[Array, "n"], distance: Float[Array, "n"]
    ) -> tuple[Float[Array, "n"], Float[Array, "n"]]:
        """V_rho and V_s, 1/mm² per unit power; 0 outside the envelope and behind the tip."""
        rows, columns, _ = self.values.shape
        field = self.values + jnp.tensordot(self.moved, self.slopes, axes=1)
        envelope = self.grid.contact_radius + self.grid.slope * distance
        x = radius / envelope
        reached = jnp.clip(distance, self.grid.nearest, self.grid.farthest)
        y = jnp.log(reached / self.grid.nearest) / jnp.log(self.grid.farthest / self.grid.nearest)
        i, down = _taps(y * (rows - 1), rows)
        j, across = _taps(jnp.clip(x, 0.0, 1.0) * (columns - 1), columns)
        # One gather per tap: XLA on a CPU handles an axis of two badly.
        flat = field.reshape(-1, 2)
        lateral, axial = (
            sum(
                row * column * flat[:, part][(i + r) * columns + j + c]
                for r, row in enumerate(down)
                for c, column in enumerate(across)
            )
            for part in range(2)
        )
        lit = (x <= 1.0) & (distance > 0.0)
        scale = jnp.where(lit, 1.0 / jnp.square(envelope), 0.0)
        return scale * lateral, scale * axial

    def transmitted(self) -> Float[Array, ""]:
        """Part of the power that leaves the cap."""
        return self.transmitted_value + jnp.dot(self.moved, self.transmitted_slopes)


def lens_grid(
    values: Mapping[str, float],
    *,
    medium_index: float,
    nearest: float,
    farthest: float,
    reach: float,
) -> Grid:
    """A grid for lenses near the given one.

    Args:
        values: all `PARAMETERS`.
        medium_index: n0.
        nearest: distance that the frames show, mm.
        farthest: likewise.
        reach: of the envelope, over that of the given lens.
    """
    field = optics.LensField(lens_of(values), medium_index)
    contact_radius = float(field.envelope(0.0))
    slope = float(field.envelope(1.0)) - contact_radius
    return Grid(reach * contact_radius, reach * slope, nearest, farthest)


def lens_of(values: Mapping[str, ScalarLike]) -> optics.GlueLens:
    """The lens with given `PARAMETERS`, evenly launched; they may be traced."""
    length = jnp.asarray(values["rim_height"], float) + values["sag"]
    fields = {name: jnp.asarray(values[name], float) for name in PARAMETERS if name != "rim_height"}
    return optics.GlueLens(**fields, glue_length=length, launch_radius=None, launch_aperture=None)


def lens_parameters(lens: optics.GlueLens) -> dict[str, float]:
    """`PARAMETERS` of a lens.

    Raises:
        ValueError: a Gaussian launch, which the image fit does not know.
    """
    if lens.launch_radius is not None or lens.launch_aperture is not None:
        raise ValueError(
            "the image fit knows evenly filled cores only; this lens has a launch_radius or a "
            "launch_aperture. Leave them out."
        )
    fields = {name: getattr(lens, name) for name in PARAMETERS if name != "rim_height"}
    fields["rim_height"] = lens.glue_length - lens.sag
    return {name: float(fields[name]) for name in PARAMETERS}


def lens_table(
    values: Mapping[str, float], free: Sequence[str], *, medium_index: float, grid: Grid
) -> LensTable:
    """Tabulate a lens and its slopes in the free parameters.

    Args:
        values: all `PARAMETERS`.
        free: those to take slopes in.
        medium_index: n0.
        grid: where. A fit keeps it while it moves, so that what interpolation gets wrong stays.
    """
    names = tuple(free)
    at = jnp.array([values[name] for name in names])
    s = np.geomspace(grid.nearest, grid.farthest, _ROWS)[:, None]
    envelope = grid.contact_radius + grid.slope * s
    rho, s = np.broadcast_arrays(envelope * np.linspace(0.0, 1.0, _COLUMNS), s)
    batches = np.stack([rho, s]).reshape(2, -1, _BATCH).transpose(1, 0, 2)
    fixed = {name: jnp.asarray(value, float) for name, value in values.items()}
    index = jnp.asarray(medium_index, float)

    def evaluate(batch: np.ndarray) -> np.ndarray:
        return np.asarray(_with_slopes(names, at, fixed, index, *batch))

    # A batch is too small to be shared among cores; the first alone compiles.
    with ThreadPoolExecutor() as pool:
        parts = [evaluate(batches[0]), *pool.map(evaluate, batches[1:])]
    stacked = np.stack(parts, axis=2).reshape(1 + len(names), 2, _ROWS, _COLUMNS)
    samples = jnp.asarray(np.moveaxis(stacked, 1, -1) * envelope[None, :, :, None] ** 2)
    leaves = _transmitted(names, at, fixed, index)
    return LensTable(
        values=samples[0],
        slopes=samples[1:],
        transmitted_value=leaves[0],
        transmitted_slopes=leaves[1:],
        moved=jnp.zeros(len(names)),
        grid=jax.tree.map(jnp.asarray, grid),
    )


@eqx.filter_jit
def _with_slopes(
    names: tuple[str, ...],
    at: Float[Array, "p"],
    fixed: dict[str, Array],
    medium_index: Float[Array, ""],
    radius: Float[Array, "n"],
    distance: Float[Array, "n"],
) -> Float[Array, "p+1 2 n"]:
    """V at some points, then its derivatives."""

    def field(free: Array) -> Array:
        lens = lens_of(fixed | dict(zip(names, free, strict=True)))
        return jnp.stack(
            optics.vector_irradiance(
                lens, medium_index=medium_index, radius=radius, distance=distance
            )
        )

    return _value_and_slopes(field, at)


@eqx.filter_jit
def _transmitted(names, at, fixed, medium_index) -> Float[Array, "p+1"]:
    def share(free: Array) -> Array:
        lens = lens_of(fixed | dict(zip(names, free, strict=True)))
        return optics.transmitted_power(lens, medium_index=medium_index)

    return _value_and_slopes(share, at)


def _value_and_slopes(function: Callable[[Array], Array], at: Float[Array, "p"]) -> Array:
    if not at.size:
        return function(at)[None]
    value, slopes = jax.vmap(
        lambda direction: jax.jvp(function, (at,), (direction,)), out_axes=(None, 0)
    )(jnp.eye(at.size))
    return jnp.concatenate([value[None], slopes])


def _taps(place: Array, count: int) -> tuple[Array, tuple[Array, Array, Array, Array]]:
    """First of the four samples around a place, and their weights in the cubic through them."""
    first = jnp.clip(place.astype(int) - 1, 0, count - 4)
    t = place - first
    return first, (
        (t - 1) * (t - 2) * (t - 3) / -6,
        t * (t - 2) * (t - 3) / 2,
        t * (t - 1) * (t - 3) / -2,
        t * (t - 1) * (t - 2) / 6,
    )
