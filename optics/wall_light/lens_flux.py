r"""Light of a glue lens on the wall behind pixels, from a table to first order in its parameters.

The vector irradiance V has no sources between the lens and the wall, and it is symmetric about the
beam. So the light through any patch is a line integral around its border (Stokes' stream function),

$$ \Phi = \tfrac12 \oint M(\rho, s)\,\mathbf u \cdot (\boldsymbol\rho \times d\mathbf l),
   \qquad M = \frac{1}{\pi\rho^2} \int_0^\rho V_s\,2\pi\rho'\,d\rho', $$

with the mean M of V_s over the disc of radius rho around the beam u. M is continuous where V jumps,
as at a sharp image of the core, and no light is lost between patches.

Quadrature at every pixel would take minutes per frame. A grid over the visible distances and radii
takes seconds, including the derivatives with respect to the lens's parameters. Its samples are
denser at edges of the light, as in `optics.irradiance_table`: in its focal plane a lens makes a
sharp image of its core.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import tomli_w
from jax.typing import ArrayLike
from jaxtyping import Array, Bool, Float, ScalarLike
from scipy.interpolate import make_interp_spline
from scipy.ndimage import binary_dilation, maximum_filter, minimum_filter

from eyespot import optics
from eyespot.formats.inputs import InputError
from eyespot.optics.irradiance import values_at
from eyespot.optics.wall_light.cells import Sides, off_axis_part

PARAMETERS = (
    "core_radius",
    "aperture_radius",
    "rim_height",
    "sag",
    "glue_index",
    "numerical_aperture",
)
"""A lens's shape and light. `rim_height` is the height of the cap's rim over the core, mm. It
replaces the glue's length, so that a change of the sag alone keeps the lens possible."""
TABLE_CODE = (*optics.LIGHT_CODE, Path(__file__), Path(__file__).with_name("cells.py"))
"""The source files on which a `LensTable` depends."""
FLATTEST = 0.02
"""Sag over the aperture's radius below which the end is nearly flat, and changes of the sag count
as parts of this. The light is then linear in the sag, through zero, where the cap turns hollow."""


def lens_of(values: Mapping[str, ScalarLike]) -> optics.GlueLens:
    """The lens with the given `PARAMETERS` (may be traced) and a uniform launch."""
    length = jnp.asarray(values["rim_height"], float) + values["sag"]
    fields = {name: jnp.asarray(values[name], float) for name in PARAMETERS if name != "rim_height"}
    return optics.GlueLens(**fields, glue_length=length, launch_radius=None, launch_aperture=None)


def lens_parameters(lens: optics.GlueLens) -> dict[str, float]:
    """`PARAMETERS` of a lens.

    Raises:
        InputError: a Gaussian launch, which the image fit does not support.
    """
    if lens.launch_radius is not None or lens.launch_aperture is not None:
        raise InputError(
            "the image fit supports uniformly filled cores only; this lens has a launch_radius or "
            "a launch_aperture. Leave them out."
        )
    fields = {name: getattr(lens, name) for name in PARAMETERS if name != "rim_height"}
    fields["rim_height"] = lens.glue_length - lens.sag
    return {name: float(fields[name]) for name in PARAMETERS}


def lens_toml(values: Mapping[str, float], *, provenance: str) -> str:
    """The text of a lens file, which `optics.load_lens` reads.

    Args:
        values: all `PARAMETERS`.
        provenance: where they come from.
    """
    lens = {name: float(x) for name, x in vars(lens_of(values)).items() if x is not None}
    return tomli_w.dumps({"schema": 1, "provenance": provenance, "lens": lens})


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

    def envelope(self, distance: Float[ArrayLike, "*n"]) -> Float[ArrayLike, "*n"]:
        """Radius outside which there is no light, mm."""
        return self.contact_radius + self.slope * distance


class LensTable(eqx.Module):
    """Mean light within a radius, to first order in the lens's parameters, cubic between samples.

    Rows are uniform in ln s, columns in rho / e(s), with the envelope e(s); samples are M e(s)².

    Attributes:
        values: the samples, followed by their derivatives with respect to each parameter.
        power: fraction of the power that leaves the cap, and its derivatives.
        moved: difference of the current parameters from those of the samples.
        grid: positions of the samples.
    """

    values: Float[Array, "p+1 rows columns"]
    power: Float[Array, "p+1"]
    moved: Float[Array, "p"]
    grid: Grid

    def __call__(
        self, *, radius: Float[Array, "*n"], distance: Float[Array, "*n"]
    ) -> Float[Array, "*n"]:
        """M, 1/mm² per unit power; 0 behind the tip."""
        _, rows, columns = self.values.shape
        envelope = jnp.asarray(self.grid.envelope(distance))
        x = radius / envelope
        reached = jnp.clip(distance, self.grid.nearest, self.grid.farthest)
        y = jnp.log(reached / self.grid.nearest) / jnp.log(self.grid.farthest / self.grid.nearest)
        column = jnp.clip(x, 0.0, 1.0) * (columns - 1)
        mean = _interpolated(self.values, self.moved, y * (rows - 1), column)
        # A disc that is larger than the envelope has all the light too.
        scale = jnp.square(envelope * jnp.maximum(x, 1.0))
        return jnp.where(distance > 0.0, mean / scale, 0.0)

    def through(
        self, sides: Sides, *, tip: Float[Array, "3"], axis: Float[Array, "3"]
    ) -> Float[Array, "..."]:
        """Light between each side and the axis, per unit power."""
        offset = sides.node - tip
        lateral = off_axis_part(offset, axis)
        radius = jnp.sqrt(optics.dot(lateral, lateral) + 1e-24)
        swept = optics.dot(jnp.cross(axis, lateral), sides.step)
        mean = self(radius=radius, distance=optics.dot(offset, axis))
        return jnp.sum(0.5 * mean * swept, axis=-1)

    def changed(self, by: Float[Array, "p"]) -> "LensTable":
        """The table with the lens's parameters changed."""
        return eqx.tree_at(lambda table: table.moved, self, self.moved + by)

    def parts(self) -> list["LensTable"]:
        """The table without its derivatives, and its derivatives, as tables of their own."""
        each = zip(self.values[:, None], self.power[:, None], strict=True)
        return [LensTable(values, power, self.moved[:0], self.grid) for values, power in each]

    def half_maximum_radius(self, distance: float) -> float:
        """Outermost radius with half of the peak irradiance on a plane at a distance, both in mm.

        To a four-hundredth of the light's reach; `optics.half_maximum_radius` is exact.
        """
        radius = np.linspace(0.0, float(np.asarray(self.grid.envelope(distance))), 400)
        mean = np.asarray(self(radius=jnp.asarray(radius), distance=jnp.full(400, distance)))
        rings = np.diff(mean * radius**2) / np.diff(radius**2)
        return float(radius[1:][rings >= 0.5 * rings.max()][-1])

    def arrays(self) -> dict[str, Any]:
        """All that `of_arrays` needs, by name."""
        parts = vars(self) | self.grid._asdict()
        return {name: np.asarray(part) for name, part in parts.items() if name != "grid"}

    @classmethod
    def array_names(cls) -> set[str]:
        """Names of `arrays`."""
        return {*cls.__dataclass_fields__, *Grid._fields} - {"grid"}

    @classmethod
    def of_arrays(cls, kept: Mapping[str, ArrayLike]) -> "LensTable":
        """A table from its `arrays`."""
        arrays = {name: jnp.asarray(part) for name, part in kept.items()}
        grid = Grid(*(arrays.pop(name) for name in Grid._fields))
        return cls(**arrays, grid=grid)

    def transmitted(self) -> Float[Array, ""]:
        """Fraction of the power that leaves the cap."""
        return self.power[0] + jnp.dot(self.moved, self.power[1:])


@jax.custom_jvp
def _interpolated(
    values: Float[Array, "p+1 rows columns"],
    moved: Float[Array, "p"],
    row: Float[Array, "*n"],
    column: Float[Array, "*n"],
) -> Float[Array, "*n"]:
    """The mean light at positions between samples."""
    return _at(values, moved, row, column)[0]


@_interpolated.defjvp
def _interpolated_slope(primals, tangents):
    """Derivative for constant samples.

    By JAX's own rules each direction would interpolate again, which is four times as slow.
    """
    value, by_row, by_column, *by_moved = _at(*primals)
    _, moved, row, column = tangents
    slope = by_row * row + by_column * column
    return value, slope + sum(moved[k] * field for k, field in enumerate(by_moved))


def _at(values: Array, moved: Array, row: Array, column: Array) -> list[Float[Array, "*n"]]:
    """The mean light, and its derivatives by row, column and `moved`."""
    _, rows, columns = values.shape
    i, down, steps_down = _taps(row, rows)
    j, across, steps_across = _taps(column, columns)
    # All samples at once: gathered one by one they take six times as long to compile.
    beside = np.add.outer(columns * np.arange(4), np.arange(4)).reshape(4, 4, *(1 for _ in i.shape))
    at = columns * i + j + beside

    def samples(field: Array) -> Array:
        return field.ravel().at[at].get(mode="promise_in_bounds")

    def weighted(down: Array, across: Array, field: Array) -> Array:
        return jnp.sum(down[:, None] * across * field, axis=(0, 1))

    still, *changes = (samples(field) for field in values)
    # Of the whole table this sum would take as long as all else.
    light = still + sum(moved[k] * change for k, change in enumerate(changes))
    at_place = [(down, across), (steps_down, across), (down, steps_across)]
    parts = [weighted(*weights, light) for weights in at_place]
    return parts + [weighted(down, across, change) for change in changes]


def _taps(place: Array, count: int) -> tuple[Array, Array, Array]:
    """First of the four samples around a position; weights of their cubic and of its slope."""
    first = jnp.clip(place.astype(int) - 1, 0, count - 4)
    t = place - first

    def weights(t: Array) -> Array:
        cubic = (
            (t - 1) * (t - 2) * (t - 3) / -6,
            t * (t - 2) * (t - 3) / 2,
            t * (t - 1) * (t - 3) / -2,
            t * (t - 1) * (t - 2) / 6,
        )
        return jnp.stack(cubic)

    return first, *jax.jvp(weights, (t,), (jnp.ones_like(t),))


_ROWS, _COLUMNS = 6, 12  # cells of the first grid
_WHOLE = {True: 1, False: 2}
"""How often all cells are halved by quadrature, for coarse and for exact tables."""
TABLE_ERROR = 5e-4
"""Error of the spline that an exact table accepts, of a row's peak."""
_OF_CHANGE = 1e-4
"""The same for a table that is computed from one of a near lens. What it lacks has one sign over
wide parts of the light, unlike the error of a spline, so it biases a fit more."""
_CHANGE = _OF_CHANGE**0.5
"""Change of the light, of a row's peak, whose square, which a table of first order lacks, is as
large as that error. Where a table's light changes by more, quadrature replaces its samples."""
_STEP, _STILL = 0.1, 0.1
"""Difference of neighbouring samples, of a row's peak, that counts as a step; and how far steps may
move, in cells, before their samples are computed anew."""
_LEAST_SIZE = 0.01
"""Size of a lens's parameter for its relative change: a level rim and a flat end are 0 mm high, and
what they add counts by a part of the core's radius, 0.05 to 0.3 mm."""
_TOLERANCE = {True: 1e-2, False: TABLE_ERROR}
"""Of a row's peak, for coarse and for exact tables; cells with a larger error of the spline are
halved again."""
_COARSE_LEVELS = 2
"""How often a coarse table's cells are halved by quadrature; then the spline gives all samples."""
_MOST_HALVINGS = 7


def halvings_for(
    values: Mapping[str, float], *, medium_index: float, farthest: float, finest: float
) -> int:
    """How often the first grid's cells must be halved to be no wider than `finest` everywhere.

    Args:
        values: all `PARAMETERS`.
        medium_index: n0.
        farthest: largest visible distance, mm. There the cells are widest.
        finest: mm on the wall. What is smaller than a pixel's part is not visible.
    """
    envelope = float(optics.LensField(lens_of(values), medium_index).envelope(farthest))
    return int(np.clip(math.ceil(math.log2(envelope / _COLUMNS / finest)), 3, _MOST_HALVINGS))


def lens_samples(
    values: Mapping[str, float],
    free: Sequence[str],
    *,
    medium_index: float,
    nearest: float,
    farthest: float,
    reach: float,
    halvings: int,
    finest: float,
    coarse: bool = False,
    near: "LensSamples | None" = None,
) -> "LensSamples":
    """Sample the light of a lens and its derivatives with respect to the free parameters.

    Quadrature gives all samples of a first grid. Then each grid has cells of half the size, and
    quadrature only near samples for which the cubic spline through the previous grid is wrong, if
    the cells there are still too wide. The spline gives the others. The samples follow the light's
    edges, so a table serves its own lens and small changes only.

    With the samples of a lens `near`, the same is done with the difference from their light to
    first order. Most of it is so small and smooth that few samples are needed.

    Args:
        values: all `PARAMETERS`.
        free: names of the parameters to differentiate with respect to.
        medium_index: n0.
        nearest: least visible distance, mm.
        farthest: largest visible distance, mm.
        reach: size of the envelope relative to that of the given lens.
        halvings: how often the first grid's cells are halved.
        finest: width below which cells are not halved by quadrature, mm on the wall. The envelope
            grows with the distance, so near cells reach it before far ones.
        coarse: whether errors of a hundredth of the peak are small enough. Coarse and exact tables
            have the same shape, so that the image model is compiled once.
        near: samples of nearly the same lens. Their grid is kept if it is wide enough; `nearest`,
            `farthest` and `reach` are then not used.
    """
    envelope = optics.LensField(lens_of(values), medium_index).envelope
    contact_radius = float(envelope(0.0))
    slope = float(envelope(1.0)) - contact_radius
    grid = Grid(reach * contact_radius, reach * slope, nearest, farthest)
    if near is not None and np.less(np.array(near.grid[:2]), (contact_radius, slope)).any():
        near = None  # some of the light lies outside its grid
    if near is not None:
        grid = near.grid
    field = _Field(values, tuple(free), medium_index, grid)
    at = field.at
    first, changed = _first_order(near, at, halvings)
    missed = np.ones((_ROWS + 1, _COLUMNS + 1), bool)
    samples = field(missed, np.zeros((1 + len(free), *missed.shape)))
    for level in range(halvings):
        stride = 2 ** (halvings - level - 1)
        known = first[:, ::stride, ::stride]
        guess = _halved(samples - known[:, ::2, ::2]) + known
        wide = 2.0 * field.widths(known.shape[1:])[:, None] > finest
        wanted = changed[::stride, ::stride] & wide
        if coarse and level == _COARSE_LEVELS:
            missed[:] = False
        if missed.any():
            close = binary_dilation(missed, np.ones((3, 3)))
            wanted |= np.kron(close, np.ones((2, 2), bool))[:-1, :-1]
        wanted[::2, ::2] = False
        samples = field(wanted, guess)
        error = np.abs(samples - guess)[0]
        tolerance = _TOLERANCE[coarse] if near is None else _OF_CHANGE
        missed = error > tolerance * samples[0].max(axis=1, keepdims=True)
        missed &= field.widths(samples.shape[1:])[:, None] > finest
        missed |= near is None and level + 1 < _WHOLE[coarse]
    return LensSamples(samples, field.transmitted(), at, grid)


def _first_order(
    near: "LensSamples | None", at: Float[np.ndarray, "p"], halvings: int
) -> tuple[Float[np.ndarray, "p+1 rows columns"], Bool[np.ndarray, "rows columns"]]:
    """The light of a lens near a known one, and where it has changed too much for this."""
    if near is None:
        shape = _ROWS * 2**halvings + 1, _COLUMNS * 2**halvings + 1
        return np.zeros((1 + at.size, *shape)), np.zeros(shape, bool)
    light, slopes = near.values[0], near.values[1:]
    change = np.tensordot(at - near.at, slopes, axes=1)
    peak = light.max(axis=1, keepdims=True)
    moved = maximum_filter(np.abs(change), 3) > _CHANGE * peak
    # A step between two samples moves, although both have no derivative: about as many cells as
    # the lens's relative change of all columns, and at most twice as many.
    sizes = np.maximum(np.abs(near.at), _LEAST_SIZE)
    relative = np.max(np.abs(at - near.at) / sizes, initial=0.0)
    cells = 2.0 * relative * light.shape[1]
    if cells > _STILL:
        step = maximum_filter(light, 3) - minimum_filter(light, 3) > _STEP * peak
        moved |= maximum_filter(step, 2 * math.ceil(cells) + 1)
    return np.array([light + change, *slopes]), moved


class LensSamples(NamedTuple):
    """V_s e² of a lens on a grid.

    Attributes:
        values: the samples, followed by their derivatives with respect to each free parameter.
        power: fraction of the power that leaves the cap, and its derivatives.
        at: values of the free parameters.
    """

    values: Float[np.ndarray, "p+1 rows columns"]
    power: Float[np.ndarray, "p+1"]
    at: Float[np.ndarray, "p"]
    grid: Grid

    def table(self) -> LensTable:
        """The table of these samples: means of V_s e² over the discs within each column's radius.

        The integral over all columns is known: it is the transmitted power. What a row lacks of it
        is given to the cells in which the spline and the trapezoidal rule disagree. These are cells
        with a step, and the samples show its place only to a part of the cell.
        """
        x = np.linspace(0.0, 1.0, self.values.shape[-1])
        rings = 2.0 * x * self.values
        parts = np.diff(make_interp_spline(x, rings, axis=-1).antiderivative()(x), axis=-1)
        doubt = np.abs(parts - 0.5 * (rings[..., 1:] + rings[..., :-1]) * x[1]) + 1e-300
        rest = self.power[:, None, None] / np.pi - parts.sum(axis=-1, keepdims=True)
        parts += rest * doubt / doubt.sum(axis=-1, keepdims=True)
        within = np.cumsum(parts, axis=-1) / x[1:] ** 2
        means = np.concatenate([self.values[..., :1], within], axis=-1)
        power, grid = jnp.asarray(self.power), jax.tree.map(jnp.asarray, self.grid)
        return LensTable(jnp.asarray(means), power, jnp.zeros(len(self.at)), grid)


_USUAL = ("sag", "numerical_aperture", "core_radius", "aperture_radius")
"""Parameters whose derivatives are computed together if only some of them are asked for: one
program serves fits and readings. To compile another one would take longer than they do."""


class _Field:
    """V_s e² of a lens on a grid, and its derivatives with respect to some parameters."""

    def __init__(
        self, values: Mapping[str, float], names: tuple[str, ...], medium_index: float, grid: Grid
    ) -> None:
        self.grid, self.at = grid, np.array([values[name] for name in names])
        self.names = _USUAL if names and set(names) <= {*_USUAL} else names
        self.asked = [0, *(1 + self.names.index(name) for name in names)]
        self.around = jnp.array([values[name] for name in self.names])
        self.fixed = {name: jnp.asarray(value, float) for name, value in values.items()}
        self.medium_index = jnp.asarray(medium_index, float)

    def __call__(
        self,
        wanted: Bool[np.ndarray, "rows columns"],
        known: Float[np.ndarray, "p+1 rows columns"],
    ) -> Float[np.ndarray, "p+1 rows columns"]:
        """The known samples, with the wanted ones computed."""
        if not wanted.any():
            return known
        samples = known.copy()
        row, column = np.nonzero(wanted)
        rows, columns = wanted.shape
        s = self._distance(row, rows)
        envelope = self.grid.envelope(s)
        points = np.stack([envelope * column / (columns - 1), s])
        light = values_at(partial(self._with_slopes, _axial), points)
        samples[..., row, column] = light * envelope**2
        return samples

    def _distance(self, row: np.ndarray, rows: int) -> np.ndarray:
        """Distance of rows from the tip, mm."""
        grid = self.grid
        return np.asarray(grid.nearest * (grid.farthest / grid.nearest) ** (row / (rows - 1)))

    def widths(self, shape: tuple[int, int]) -> Float[np.ndarray, "rows"]:
        """Width of a cell in each row of a grid of this shape, mm."""
        rows, columns = shape
        return np.asarray(self.grid.envelope(self._distance(np.arange(rows), rows))) / (columns - 1)

    def transmitted(self) -> Float[np.ndarray, "p+1"]:
        """Fraction of the power that leaves the cap, and its derivatives."""
        return self._with_slopes(optics.transmitted_power)

    def _with_slopes(self, light: Callable[..., Array], *where: np.ndarray) -> np.ndarray:
        given = self.names, self.around, self.fixed, self.medium_index
        return np.asarray(_with_slopes(light, *given, *where))[self.asked]


def _halved(samples: Float[np.ndarray, "p n m"]) -> Float[np.ndarray, "p 2n-1 2m-1"]:
    """Samples of a cubic spline through the given ones, at half their spacing."""
    for axis in (1, 2):
        count = samples.shape[axis]
        halves = np.arange(2 * count - 1) / 2
        samples = make_interp_spline(np.arange(count), samples, axis=axis)(halves)
    return samples


def _axial(lens: optics.GlueLens, radius: Array, distance: Array, *, medium_index: Array) -> Array:
    """V_s at some points."""
    return optics.vector_irradiance(
        lens, medium_index=medium_index, radius=radius, distance=distance
    )[1]


@eqx.filter_jit
def _with_slopes(
    light: Callable[..., Array],
    names: tuple[str, ...],
    at: Float[Array, "p"],
    fixed: dict[str, Array],
    medium_index: Float[Array, ""],
    *where: Float[ArrayLike, "n"],
) -> Float[Array, "p+1 *n"]:
    """Light of a lens, followed by its derivatives with respect to the named parameters."""

    def of(free: Array) -> Array:
        lens = lens_of(fixed | dict(zip(names, free, strict=True)))
        return light(lens, *where, medium_index=medium_index)

    if not names:
        return of(at)[None]
    value, slopes = jax.vmap(lambda way: jax.jvp(of, (at,), (way,)), out_axes=(None, 0))(
        jnp.eye(at.size)
    )
    return jnp.concatenate([value[None], slopes])
