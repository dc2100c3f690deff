"""Vector irradiance of a lens and its derivatives on a small grid.

Quadrature at every pixel would take minutes per frame. A grid over the visible distances and radii
takes seconds, including the derivatives with respect to the lens's parameters. It is computed again
when the fit has moved. Its samples are denser at edges of the light, as in
`optics.irradiance_table`: in its focal plane a lens makes a sharp image of its core.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, ScalarLike
from scipy.interpolate import CubicSpline
from scipy.ndimage import binary_dilation

import optics
from calibration.pixels.lens import lens_of

_ROWS, _COLUMNS = 24, 48  # cells of the first grid, for which all samples are computed
_TOLERANCE = 1e-3  # of a row's peak; cells with a larger error of the spline are halved again
_BATCH = 64  # points per call, few enough to stay in the cache, as in optics.irradiance


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
    """Vector irradiance, to first order in the lens's parameters, cubic between samples.

    Rows are uniform in ln s, columns in rho / e(s); samples are V e(s)², as in
    `optics.IrradianceTable`.

    Attributes:
        values: samples at the parameters `at`.
        slopes: derivatives of the samples with respect to each parameter.
        transmitted_value: fraction of the power that leaves the cap.
        transmitted_slopes: its derivatives.
        at: parameters for which the table was computed.
        moved: difference of the current parameters from `at`.
        grid: positions of the samples.
    """

    values: Float[Array, "rows columns 2"]
    slopes: Float[Array, "p rows columns 2"]
    transmitted_value: Float[Array, ""]
    transmitted_slopes: Float[Array, "p"]
    at: Float[Array, "p"]
    moved: Float[Array, "p"]
    grid: Grid

    def __call__(
        self, *, radius: Float[Array, "*n"], distance: Float[Array, "*n"]
    ) -> tuple[Float[Array, "*n"], Float[Array, "*n"]]:
        """V_rho and V_s, 1/mm² per unit power; 0 outside the envelope and behind the tip."""
        rows, columns, _ = self.values.shape
        envelope = self.grid.contact_radius + self.grid.slope * distance
        x = radius / envelope
        reached = jnp.clip(distance, self.grid.nearest, self.grid.farthest)
        y = jnp.log(reached / self.grid.nearest) / jnp.log(self.grid.farthest / self.grid.nearest)
        lateral, axial = _interpolated(
            self.values,
            self.slopes,
            self.moved,
            y * (rows - 1),
            jnp.clip(x, 0.0, 1.0) * (columns - 1),
        )
        lit = (x <= 1.0) & (distance > 0.0)
        scale = jnp.where(lit, 1.0 / jnp.square(envelope), 0.0)
        return scale * lateral, scale * axial

    def transmitted(self) -> Float[Array, ""]:
        """Fraction of the power that leaves the cap."""
        return self.transmitted_value + jnp.dot(self.moved, self.transmitted_slopes)


def lens_table(
    values: Mapping[str, float],
    free: Sequence[str],
    *,
    medium_index: float,
    nearest: float,
    farthest: float,
    reach: float,
    halvings: int,
) -> LensTable:
    """Tabulate a lens and its derivatives with respect to the free parameters.

    Quadrature gives all samples of a first grid. Then each grid has cells of half the size, and
    quadrature only near samples for which the cubic spline through the previous grid is wrong. The
    spline gives the others. The samples follow the light's edges, so a table serves its own lens
    and small changes only.

    Args:
        values: all `PARAMETERS`.
        free: names of the parameters to differentiate with respect to.
        medium_index: n0.
        nearest: least visible distance, mm.
        farthest: largest visible distance, mm.
        reach: size of the envelope relative to that of the given lens.
        halvings: how often the first grid's cells may be halved; the first time for all cells.
    """
    envelope = optics.LensField(lens_of(values), medium_index).envelope
    contact_radius = float(envelope(0.0))
    slope = float(envelope(1.0)) - contact_radius
    grid = Grid(reach * contact_radius, reach * slope, nearest, farthest)
    field = _Field(values, tuple(free), medium_index, grid)
    missed = np.ones((_ROWS + 1, _COLUMNS + 1), bool)
    samples = field(missed)
    for _ in range(halvings):
        if not missed.any():
            break
        guess = _halved(samples)
        wanted = np.kron(binary_dilation(missed, np.ones((3, 3))), np.ones((2, 2), bool))[:-1, :-1]
        wanted[::2, ::2] = False
        samples = field(wanted, guess)
        error = np.abs(samples - guess)[0].max(axis=0)
        missed = error > _TOLERANCE * samples[0, 1].max(axis=1, keepdims=True)
    return field.table(samples)


class _Field:
    """V e² of a lens on a grid, and its derivatives with respect to some parameters."""

    def __init__(
        self, values: Mapping[str, float], names: tuple[str, ...], medium_index: float, grid: Grid
    ) -> None:
        self.names, self.grid = names, grid
        self.at = jnp.array([values[name] for name in names])
        self.fixed = {name: jnp.asarray(value, float) for name, value in values.items()}
        self.medium_index = jnp.asarray(medium_index, float)

    def __call__(
        self, wanted: Bool[np.ndarray, "rows columns"], known: np.ndarray | None = None
    ) -> Float[np.ndarray, "p+1 2 rows columns"]:
        """The known samples, with the wanted ones computed."""
        samples = (
            np.empty((1 + len(self.names), 2, *wanted.shape)) if known is None else known.copy()
        )
        row, column = np.nonzero(wanted)
        rows, columns = wanted.shape
        grid = self.grid
        s = grid.nearest * (grid.farthest / grid.nearest) ** (row / (rows - 1))
        envelope = grid.contact_radius + grid.slope * s
        points = np.stack([envelope * column / (columns - 1), s])
        points = np.pad(points, ((0, 0), (0, -row.size % _BATCH)), mode="edge")
        batches = points.reshape(2, -1, _BATCH).transpose(1, 0, 2)

        def evaluate(batch: np.ndarray) -> np.ndarray:
            own = (self.names, self.at, self.fixed, self.medium_index)
            return np.asarray(_with_slopes(*own, *batch))

        # A batch is too small for several cores. The first batch runs alone, to compile only once.
        with ThreadPoolExecutor() as pool:
            parts = [evaluate(batches[0]), *pool.map(evaluate, batches[1:])]
        samples[..., row, column] = np.concatenate(parts, axis=-1)[..., : row.size] * envelope**2
        return samples

    def table(self, samples: Float[np.ndarray, "p+1 2 rows columns"]) -> LensTable:
        """The table of these samples."""
        samples = np.moveaxis(samples, 1, -1)
        leaves = _transmitted(self.names, self.at, self.fixed, self.medium_index)
        return LensTable(
            values=jnp.asarray(samples[0]),
            slopes=jnp.asarray(samples[1:]),
            transmitted_value=leaves[0],
            transmitted_slopes=leaves[1:],
            at=self.at,
            moved=jnp.zeros(len(self.names)),
            grid=jax.tree.map(jnp.asarray, self.grid),
        )


def _halved(samples: Float[np.ndarray, "p 2 n m"]) -> Float[np.ndarray, "p 2 2n-1 2m-1"]:
    """Samples of a cubic spline through the given ones, at half their spacing."""
    for axis in (2, 3):
        count = samples.shape[axis]
        samples = CubicSpline(np.arange(count), samples, axis=axis)(np.arange(2 * count - 1) / 2)
    return samples


@eqx.filter_jit
def _with_slopes(
    names: tuple[str, ...],
    at: Float[Array, "p"],
    fixed: dict[str, Array],
    medium_index: Float[Array, ""],
    radius: Float[Array, "n"],
    distance: Float[Array, "n"],
) -> Float[Array, "p+1 2 n"]:
    """V at some points, followed by its derivatives."""

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


@jax.custom_jvp
def _interpolated(
    values: Float[Array, "rows columns 2"],
    slopes: Float[Array, "p rows columns 2"],
    moved: Float[Array, "p"],
    row: Float[Array, "*n"],
    column: Float[Array, "*n"],
) -> Float[Array, "2 *n"]:
    """The two components at positions between samples."""
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
) -> list[Float[Array, "2 *n"]]:
    """The two components, and with `gradient` their derivatives by row, column and `moved`."""
    rows, columns, _ = values.shape
    i, down, steps_down = _taps(row, rows)
    j, across, steps_across = _taps(column, columns)
    found: list[list[Array]] = []
    for part in range(2):
        sums: list[Any] = [0.0] * (3 + len(slopes))
        for r in range(4):
            for c in range(4):
                # One gather per tap, because XLA is slow on a CPU for an axis of length two.
                at = (i + r) * columns + j + c
                own = [field[..., part].ravel()[at] for field in slopes]
                light = values[..., part].ravel()[at]
                light += sum(moved[k] * field for k, field in enumerate(own))
                weight = down[r] * across[c]
                added = [weight * light]
                if gradient:
                    added += [steps_down[r] * across[c] * light, down[r] * steps_across[c] * light]
                    added += [weight * field for field in own]
                sums = [old + new for old, new in zip(sums, added, strict=False)]
        found.append(sums)
    return [jnp.stack(pair) for pair in zip(*found, strict=True)]


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
