r"""What one frame says of a distance, if nobody knows the wall: its Cramér-Rao bound.

The log light of cell i is $\log g + \log\rho_i + \log(E_i + A)$ plus noise. The log reflectance
$\log\rho$ of the wall is a Gaussian process with the covariance K (`texture`), and it is eliminated
exactly. The pose, the gain g and the ambient light A are free, and so is the blur: nobody knows
how far the microscope is out of focus. With the derivatives J by these eight, the variances N of
the camera's noise, of a model error and of the texture within steep cells, and the precision P of
what is known of the blur,

$$ F = J^T (K + N)^{-1} J + P, \qquad \sigma_d^2 = (F^{-1})_{dd}. $$
"""

from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Float, ScalarLike

from eyespot import optics
from eyespot.optics.wall_light.cells import CellBeam, square_lattice
from eyespot.optics.wall_light.cone import UniformCone
from eyespot.optics.wall_light.pose_light import beam_at_wall, irradiance_and_slopes

COUNT, REACH, BESIDE_PX = 26, 2.0, 6.0
"""Cells along a side of the window; half of its side over the half-maximum ellipse's, and beside
it. They are those of the mode pixels."""
LATTICES = (
    (0.125, -0.375, 0.125),
    (0.375, -0.125, -0.375),
    (0.625, 0.125, 0.375),
    (0.875, 0.375, -0.125),
)
"""By how much, px, cells are larger than whole pixels; and how far the spot's middle is from a
cell's corner to the right and downwards, over a cell's side. An edge that is sharper than a cell
says more or less of the distance as cells cut it: variances are means over these lattices."""
LENGTHS_MM, CONTRASTS = (0.08, 0.25, 1.0), (0.02, 0.05, 0.07)
"""Grain, vessels and shading of a wall: correlation lengths, from a few pixels to the size of a
spot, and relative standard deviations, of the order of a retina's."""
MODEL_ERROR = 0.003
"""Relative error of a cell's light by the image model."""
BLUR_PX2 = 2.0
"""Standard deviation of the blur's variance: most images are nearly in focus."""
_LIT_STEP_WIDTH = 0.05  # width of the step by which cells count as lit, over the peak
WITHIN = 0.52  # mean distance of two points of a square, over its side
_UNSEEN_VARIANCE = 1e6  # variance of a cell that says nothing


def texture(apart_mm: Float[ArrayLike, "*n"]) -> Float[Array, "*n"]:
    """Covariance of the log reflectance of places that are some way apart on the wall.

    Grain is rough, exp(-x). The rest is smooth in small: Matérn covariances of the order 3/2
    (Stein 1999).

    Args:
        apart_mm: mm along the wall.
    """
    grain, *smooth = (apart_mm / length for length in LENGTHS_MM)
    parts = [jnp.exp(-grain), *((1 + 3**0.5 * x) * jnp.exp(-(3**0.5) * x) for x in smooth)]
    return jnp.tensordot(jnp.square(jnp.array(CONTRASTS)), jnp.stack(parts), 1)


class SpotCells(NamedTuple):
    """The light of a spot on lattices of COUNT x COUNT cells around it, and how it changes.

    Attributes:
        light: irradiance per unit power, 1/mm², and its derivatives by the five numbers of a pose
            (`BeamFrame`); for each part of the beam.
        seen: cells within the image.
        side_mm: of a cell on the wall.
    """

    light: Float[np.ndarray, "lattices parts 6 n"]
    seen: Bool[np.ndarray, "lattices n"]
    side_px: Float[np.ndarray, "lattices"]
    side_mm: Float[np.ndarray, "lattices"]


def spot_cells(
    parts: Sequence[CellBeam],
    *,
    camera: optics.Camera,
    wall: optics.Surface,
    tip: Float[np.ndarray, "3"],
    axis: Float[np.ndarray, "3"],
    half_maximum_mm: float,
    size_px: tuple[int, int],
) -> SpotCells:
    """The cells around a beam's spot.

    Args:
        parts: a beam, and tables of its derivatives by its own parameters (`LensTable.parts`).
        tip: S, mm.
        axis: unit vector from the tip towards the wall.
        half_maximum_mm: larger semi-axis of the half-maximum ellipse on the wall.
        size_px: width and height of the image.
    """
    beam = beam_at_wall(wall, tip, axis)
    assert beam is not None, "the spot has a size on the wall"
    middle, right = np.asarray(camera.project(jnp.stack([beam.spot, beam.spot + beam.right])))
    px_mm = float(np.linalg.norm(right - middle))
    lattices = np.array(LATTICES)
    sides = 2 * (REACH * half_maximum_mm * px_mm + BESIDE_PX) / COUNT + lattices[:, 0]
    light, seen = [], []
    for side, off in zip(sides, lattices[:, 1:], strict=True):
        corner, step = middle - (0.5 * COUNT + off) * side, np.array([side, 0.0])
        lattice = square_lattice(camera, wall, corner=corner, right=step, count=COUNT)
        for part in parts:
            own = jnp.zeros((2 if isinstance(part, UniformCone) else 0, 0))
            both = irradiance_and_slopes(lattice, part, beam, own=jnp.zeros(0), spread=own)
            light.append(np.vstack(both))
        first = corner + side * np.arange(COUNT)[:, None]
        inside = np.all([first > -0.5, first + side < np.array(size_px) - 0.5], axis=0)
        seen.append(np.logical_and.outer(inside[:, 1], inside[:, 0]).ravel())
    cells = np.array(light).reshape(len(sides), len(parts), -1, COUNT**2)
    return SpotCells(cells, np.array(seen), sides, sides / px_mm)


@partial(jax.jit, static_argnames="outline")
def distance_sigmas(
    spots: SpotCells,
    change: Float[ArrayLike, "parts-1"],
    *,
    ambient: Float[ArrayLike, "parts"],
    dose: ScalarLike,
    electrons: Float[ArrayLike, "channels"],
    dark_e2: ScalarLike,
    outline: bool = False,
) -> Float[Array, "n"]:
    """Bounds of the standard deviation of d by one frame each, mm; see the formula above.

    Args:
        spots: of n frames.
        change: of the beam's own parameters.
        ambient: A, light that is everywhere, per unit power, 1/mm²; of each part of the beam.
        dose: radiant exposure of the brightest cell in a frame, mJ/mm².
        electrons: of a pixel in each colour, per mJ/mm² on the wall.
        dark_e2: variance of a pixel without light, electrons².
        outline: use only cells between a quarter and three quarters of the spot's peak.

    Returns:
        Infinite where the cells that are seen do not determine the pose.
    """
    by_change = jnp.concatenate([jnp.ones(1), jnp.asarray(change)])
    everywhere = by_change @ jnp.asarray(ambient)
    squares = jnp.square(jnp.arange(COUNT))
    # Means over cells vary less than points do: even those of one cell are some way apart.
    apart = jnp.sqrt(jnp.add.outer(squares, squares) + WITHIN**2)
    steps = jnp.abs(jnp.arange(COUNT)[:, None] - jnp.arange(COUNT))

    def sigma(spot: SpotCells) -> Float[Array, ""]:
        direct, *slopes = jnp.tensordot(by_change, spot.light, 1)
        total = direct + everywhere
        mean = dose * total / jnp.max(total) * jnp.asarray(electrons)[:, None]
        information = jnp.square(spot.side_px) * jnp.sum(mean**2 / (mean + dark_e2), axis=0)
        share = direct / jnp.max(direct)
        used = spot.seen & (share > 0.25) & (share < 0.75) if outline else spot.seen
        # Light enters at the bright side of a cell, where the reflectance differs from its mean.
        down, along = jnp.gradient(jnp.log(total).reshape(COUNT, COUNT))
        steep = jnp.sqrt(down**2 + along**2 + 1e-12).ravel()
        aside = texture(jnp.zeros(())) - texture(spot.side_mm * jnp.minimum(steep / 12, 0.5))
        noise = jnp.where(used, 1.0 / information + MODEL_ERROR**2 + aside, _UNSEEN_VARIANCE)
        alike = texture(spot.side_mm * apart)[steps[:, None, :, None], steps[:, None, :]]
        covariance = alike.reshape(COUNT**2, COUNT**2) + jnp.diag(noise)
        # A blur's variance acts as time does on heat: half of the second derivatives.
        padded = jnp.pad(direct.reshape(COUNT, COUNT), 1, mode="edge")
        bend = jnp.diff(padded[:, 1:-1], 2, axis=0) + jnp.diff(padded[1:-1], 2, axis=1)
        by_blur = 0.5 * bend.ravel() / jnp.square(spot.side_px)
        states = jnp.stack([*slopes, total, everywhere * jnp.ones_like(total), by_blur]) / total
        size = jnp.linalg.norm(states, axis=1)  # mm and rad would make F ill-conditioned
        root = jnp.linalg.cholesky(covariance)
        white = jax.scipy.linalg.solve_triangular(root, (states / size[:, None]).T, lower=True)
        prior = jnp.zeros(len(size)).at[-1].set(1 / (BLUR_PX2 * size[-1]) ** 2)
        variance = jnp.linalg.inv(white.T @ white + jnp.diag(prior))[2, 2] / size[2] ** 2
        return jnp.where(variance > 0, jnp.sqrt(jnp.abs(variance)), jnp.inf)

    return jnp.sqrt(jnp.mean(jnp.square(jax.vmap(jax.vmap(sigma))(spots)), axis=1))


@jax.jit
def lit_radii(spots: SpotCells, change: Float[ArrayLike, "parts-1"]) -> Float[Array, "n"]:
    """Radii of circles as large as the spots above half of their peak, px; smooth in the beam.

    The arguments are those of `distance_sigmas`.
    """
    by_change = jnp.concatenate([jnp.ones(1), jnp.asarray(change)])
    direct = jnp.einsum("p,nlpc->nlc", by_change, spots.light[..., 0, :])
    share = direct / jnp.max(direct, axis=-1, keepdims=True)
    lit = jnp.sum(jax.nn.sigmoid((share - 0.5) / _LIT_STEP_WIDTH), axis=-1)
    return jnp.mean(spots.side_px * jnp.sqrt(lit / jnp.pi), axis=1)
