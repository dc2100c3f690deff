"""The spot's contours on a wall that spreads light, for labels."""

from __future__ import annotations

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, ScalarLike

from optics.beam import Beam, generator_angles, perpendicular_frame
from optics.camera import Camera
from optics.contour import CONTOUR_POINTS, cone_contour
from optics.ellipse import Ellipse, ellipse_of_contour
from optics.half_maximum import half_maximum_contour
from optics.irradiance_lookup import IrradianceTable
from optics.surface import Intersection, Surface
from optics.vector import dot
from optics.wall_spread import enclosed, spread_nodes

_SIDES = 256  # directions in which the cone's edge is looked for
_BISECTIONS = 40
_FARTHEST = 8.0  # of the contour from the unspread one, in L; 99.7 % of the light is nearer
_PEAK_RADII, _PEAK_ANGLES = 48, 12


class SpreadSpot(NamedTuple):
    """Ellipses of a spot on a wall that spreads light, px.

    Attributes:
        cone: of the cone's edge.
        half_max: of the half-maximum contour.
    """

    cone: Ellipse
    half_max: Ellipse


@eqx.filter_jit
def spread_spots(
    surface: Surface,
    microscope: Camera,
    table: IrradianceTable | None,
    beams: Beam,
    length: ScalarLike,
) -> SpreadSpot:
    """The ellipses of `spread_contours` in the image, one for each beam.

    Args:
        surface: the wall.
        microscope: the camera.
        table: vector irradiance of a lens; None for the ideal cone.
        beams: tips, axes and cones, along the leading axis.
        length: L, mm.
    """

    def of(beam: Beam) -> SpreadSpot:
        contours = spread_contours(table, beam, surface, length)
        return SpreadSpot(*(ellipse_of_contour(microscope.project(c)) for c in contours))

    return jax.lax.map(of, beams)


def lit_share(
    beam: Beam,
    points: Float[Array, "*batch 3"],
    outward: Float[Array, "*batch 3"],
    length: ScalarLike,
) -> Float[Array, "*batch"]:
    """Share of the wall round a point, weighed by the kernel, that lies inside a sharp cone.

    A line in the wall meets the cone where a quadratic equation has its roots, so each direction
    gives a difference of `enclosed`. The wall is taken as its tangent plane; within 3 L of 0.1 mm
    that is 4 um off the sphere.

    Args:
        beam: the cone.
        points: on the wall, mm.
        outward: the wall's normals there.
        length: L, mm.
    """
    first, second = perpendicular_frame(outward)
    angle = jnp.asarray((np.arange(_SIDES) + 0.5) * (2.0 * np.pi / _SIDES))
    along = (
        jnp.cos(angle)[:, None] * first[..., None, :]
        + jnp.sin(angle)[:, None] * second[..., None, :]
    )
    start = (points - beam.apex)[..., None, :]
    axis = jnp.broadcast_to(beam.axis, start.shape)
    square = jnp.cos(beam.half_angle) ** 2
    ahead, forwards = dot(start, axis), dot(along, jnp.broadcast_to(beam.axis, along.shape))
    a = forwards**2 - square
    b = ahead * forwards - square * dot(jnp.broadcast_to(start, along.shape), along)
    c = ahead**2 - square * dot(start, start)
    root = jnp.sqrt(jnp.maximum(b**2 - a * c, 0.0))
    far, near = (jnp.maximum((b + side * root) / -a, 0.0) for side in (1.0, -1.0))
    return jnp.mean(enclosed(far, length) - enclosed(near, length), axis=-1)


@eqx.filter_jit
def spread_contours(
    table: IrradianceTable | None, beam: Beam, surface: Surface, length: ScalarLike
) -> tuple[Float[Array, "n 3"], Float[Array, "n 3"]]:
    """The cone's edge and the half-maximum contour on a wall that spreads light.

    The edge is where half of the wall round it, weighed by the kernel, lies inside the geometric
    cone: half of the plateau. The half-maximum contour is at half of the spread light's own peak.

    Args:
        table: vector irradiance of a lens; None for the ideal cone.
        beam: tip, axis and cone.
        surface: the wall.
        length: L, mm.

    Returns:
        Wall points of both, mm; NaN where a light is spread over so much more than the spot that
        there is no such contour.
    """
    angles = jnp.asarray(generator_angles(CONTOUR_POINTS))
    first, second = perpendicular_frame(beam.axis)
    around = jnp.cos(angles)[:, None] * first + jnp.sin(angles)[:, None] * second

    def radius_of(points: Float[Array, "n 3"]) -> Float[Array, "n"]:
        return jnp.sum((points - beam.tip) * around, axis=-1)

    def wall_at(radius: Array, around: Array) -> Intersection:
        start = beam.tip + radius[..., None] * around
        return surface.intersect(start, jnp.broadcast_to(beam.axis, start.shape))

    def share(radius: Array, around: Array) -> Array:
        wall = wall_at(radius, around)
        return lit_share(beam, wall.point, -wall.normal, length)

    def light(radius: Array, around: Array) -> Array:
        if table is None:  # uniform up to its edge, as for `spot_truth`
            return share(radius, around)
        wall = wall_at(radius, around)
        return _spread_irradiance(table, beam, wall.point, wall.normal, length)

    edge = cone_contour(beam, surface).point
    unspread = edge if table is None else half_maximum_contour(table, beam, surface)
    fractions = jnp.linspace(0.0, 1.0, _PEAK_RADII)[:, None]
    sampled = slice(None, None, -(-CONTOUR_POINTS // _PEAK_ANGLES))
    inside = fractions * radius_of(unspread)[sampled]
    directions = jnp.broadcast_to(around[sampled], (*inside.shape, 3))
    level = 0.5 * jnp.max(light(inside, directions))

    def contour(value, level, start):
        low = jnp.maximum(start - _FARTHEST * length, 0.0)
        high = start + _FARTHEST * length
        exists = (value(low, around) >= level) & (value(high, around) < level)

        def halve(_, bracket):
            inner, outer = bracket
            middle = 0.5 * (inner + outer)
            bright = value(middle, around) >= level
            return jnp.where(bright, middle, inner), jnp.where(bright, outer, middle)

        low, high = jax.lax.fori_loop(0, _BISECTIONS, halve, (low, high))
        return wall_at(jnp.where(exists, 0.5 * (low + high), jnp.nan), around).point

    return contour(share, 0.5, radius_of(edge)), contour(light, level, radius_of(unspread))


def _spread_irradiance(
    table: IrradianceTable,
    beam: Beam,
    points: Float[Array, "*batch 3"],
    inward: Float[Array, "*batch 3"],
    length: ScalarLike,
) -> Float[Array, "*batch"]:
    """Irradiance averaged over the tangent plane's nodes, 1/mm^2 per unit power."""
    offsets, weights = spread_nodes()
    first, second = perpendicular_frame(inward)
    total = jnp.zeros(points.shape[:-1])
    moves = jnp.asarray(np.column_stack([offsets, weights]))

    def added(total: Array, move: Array) -> tuple[Array, None]:
        place = points + length * (move[0] * first + move[1] * second) - beam.tip
        distance = dot(place, jnp.broadcast_to(beam.axis, place.shape))
        across = place - distance[..., None] * beam.axis
        radius = jnp.sqrt(dot(across, across))
        lateral, axial = table(radius=radius, distance=distance)
        vector = (lateral / jnp.maximum(radius, 1e-12))[..., None] * across
        vector = vector + axial[..., None] * beam.axis
        return total + move[2] * jnp.maximum(-dot(vector, inward), 0.0), None

    return jax.lax.scan(added, total, moves)[0]
