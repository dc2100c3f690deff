r"""Light on a lattice of square cells of the image, from line integrals along the cells' sides.

The light through a patch of the wall is a line integral around its border (see `table`), and
two neighbours share a side. So each side is integrated once for both of its cells. The light that
leaves one cell enters the other: no light is lost or counted twice.
"""

from __future__ import annotations

from typing import NamedTuple, Protocol

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, ScalarLike

import optics
from optics.wall_light.pixel_light import off_axis_part

_NODES = 6
"""Gauss nodes on each side. With cells of 8 px, a cell that a cone's sharp edge cuts is off by
0.07 % of the step (RMS), less than the shot noise of 64 pixels with 4,000 electrons a channel."""


class MeanLight(Protocol):
    """Mean V_s of an axisymmetric beam over the disc of a radius around its axis."""

    def __call__(
        self, *, radius: Float[Array, "*n"], distance: Float[Array, "*n"]
    ) -> Float[Array, "*n"]:
        """M, 1/mm² per unit power, at a distance along the beam from the tip."""

    def changed(self, by: Float[Array, "p"]) -> MeanLight:
        """The beam with its own parameters changed, each in its unit."""


class ConeMean(eqx.Module):
    """Mean light of a uniform cone, in closed form.

    Attributes:
        half_angle: alpha, rad.
        apex_offset: b, mm.
    """

    half_angle: Float[Array, ""]
    apex_offset: Float[Array, ""]

    def __call__(
        self, *, radius: Float[Array, "*n"], distance: Float[Array, "*n"]
    ) -> Float[Array, "*n"]:
        """The share of the cone's solid angle within the radius, by the disc's area."""
        angle = jnp.minimum(jnp.arctan2(radius, distance - self.apex_offset), self.half_angle)
        share = jnp.square(jnp.sin(0.5 * angle) / jnp.sin(0.5 * self.half_angle))
        return share / (jnp.pi * jnp.square(radius))

    @classmethod
    def of(cls, half_angle: float, apex_offset: float) -> ConeMean:
        """A cone by its half-angle, rad, and apex offset, mm."""
        return cls(jnp.asarray(half_angle), jnp.asarray(apex_offset))

    def changed(self, by: Float[Array, "2"]) -> ConeMean:
        """The cone with another half-angle (rad) and apex offset (mm)."""
        return ConeMean(self.half_angle + by[0], self.apex_offset + by[1])


class Lattice(NamedTuple):
    """The wall behind a lattice of rows x columns cells.

    Attributes:
        across, along: nodes on the sides that run right and down, and steps to the next node
            times their weights, mm; (2, rows + 1, columns, nodes, 3) and
            (2, rows, columns + 1, nodes, 3).
        area: of each cell on the wall, mm².
    """

    across: Float[Array, "2 rows+1 columns nodes 3"]
    along: Float[Array, "2 rows columns+1 nodes 3"]
    area: Float[Array, "rows columns"]


def image_lattice(
    camera: optics.Camera,
    surface: optics.Surface,
    *,
    corner: Float[Array, "2"],
    side: ScalarLike,
    rows: int,
    columns: int,
) -> Lattice:
    """The wall behind cells of an image.

    Args:
        camera: the microscope, without distortion.
        surface: the wall.
        corner: (u, v) of the first cell's outer corner, px; pixel centres are integers.
        side: of a cell, px.
        rows: number of cells downwards.
        columns: number of cells to the right.
    """
    nodes, weights = np.polynomial.legendre.leggauss(_NODES)
    place, share = 0.5 * (nodes + 1.0), 0.5 * weights

    def hit(at: Array) -> Array:
        return surface.intersect(*camera.ray(at)).point

    def line(first: Array, direction: tuple[float, float]) -> Array:
        way = jnp.asarray(side) * jnp.array(direction)
        at = first[..., None, :] + place[:, None] * way
        flat = at.reshape(-1, 2)
        point, step = jax.jvp(hit, (flat,), (jnp.broadcast_to(way, flat.shape),))
        point, step = (part.reshape(*at.shape[:-1], 3) for part in (point, step))
        return jnp.stack([point, share[:, None] * step])

    v, u = jnp.meshgrid(jnp.arange(rows + 1.0), jnp.arange(columns + 1.0), indexing="ij")
    corners = corner + jnp.asarray(side) * jnp.stack([u, v], axis=-1)
    centres = (corners[:-1, :-1] + 0.5 * jnp.asarray(side)).reshape(-1, 2)

    def centre(at: Array) -> tuple[Array, Array]:
        meeting = surface.intersect(*camera.ray(at))
        return meeting.point, meeting.normal

    def moved(by: tuple[float, float]) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
        way = jnp.broadcast_to(jnp.asarray(side) * jnp.array(by), centres.shape)
        return jax.jvp(centre, (centres,), (way,))

    (_, normal), (right, _) = moved((1.0, 0.0))
    _, (down, _) = moved((0.0, 1.0))
    area = -optics.dot(normal, jnp.cross(right, down))
    return Lattice(
        across=line(corners[:, :-1], (1.0, 0.0)),
        along=line(corners[:-1], (0.0, 1.0)),
        area=area.reshape(rows, columns),
    )


def lattice_irradiance(
    wall: Lattice, mean: MeanLight, *, tip: Float[Array, "3"], axis: Float[Array, "3"]
) -> Float[Array, "rows columns"]:
    """Mean irradiance of each cell per unit power, 1/mm².

    Args:
        wall: from `image_lattice`.
        mean: of the source.
        tip: S, mm.
        axis: unit vector from the tip towards the wall.
    """

    def through(side: Array) -> Array:
        point, step = side
        offset = point - tip
        lateral = off_axis_part(offset, axis)
        radius = jnp.sqrt(optics.dot(lateral, lateral) + 1e-24)
        swept = optics.dot(jnp.cross(axis, lateral), step)
        return 0.5 * jnp.sum(
            mean(radius=radius, distance=optics.dot(offset, axis)) * swept, axis=-1
        )

    across, along = through(wall.across), through(wall.along)
    return (across[:-1] - across[1:] + along[:, 1:] - along[:, :-1]) / wall.area
