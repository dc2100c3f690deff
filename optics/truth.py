r"""The true parameters of a beam's spot, for labels.

The contour is where direct irradiance on the wall is half of its peak. A closed Lambertian eyeball
adds the same indirect irradiance everywhere. A matt wall may also spread light sideways before it
leaves; it radiates $\rho/\pi\,(E * p)$: the irradiance is averaged over the wall with the weight

$$ p(r) = \frac{e^{-r/L}}{2\pi L^2}, \qquad
   P(r) = 1 - (1 + r/L)\,e^{-r/L}, \qquad
   M(\nu) = \left(1 + (2\pi L\nu)^2\right)^{-3/2}, $$

its share within r and its modulation transfer function. The mean distance is 2 L. One length is
what is known of most walls; printing research describes paper by the same function (Inoue, Tsumura
& Miyake 1997).

For a wall that scatters in its depth L overstates what a distance loses (docs/theory/light.md). The
exponential stays because one Laguerre rule is exact enough for it, and because paper's length was
measured with it.
"""

from functools import partial
from operator import itemgetter
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float, Int, ScalarLike
from scipy.special import roots_genlaguerre

from eyespot.optics.beam import Beam
from eyespot.optics.camera import Camera
from eyespot.optics.contour import CONTOUR_POINTS, cone_contour
from eyespot.optics.ellipse import Ellipse, ellipse_of_contour
from eyespot.optics.irradiance import in_batches
from eyespot.optics.irradiance_edges import implicit_root
from eyespot.optics.lens_table import IrradianceTable
from eyespot.optics.lines import directions_across, dot, generator_angles, perpendicular_frame
from eyespot.optics.surface import HIT, Intersection, Surface, bisected

_RADII = 256
_BISECTIONS = 30


def wall_irradiance(
    table: IrradianceTable,
    beam: Beam,
    surface: Surface,
    *,
    radius: Float[Array, "*batch"],
    angle: Float[Array, "*batch"],
) -> tuple[Float[Array, "*batch"], Float[Array, "*batch 3"]]:
    """Direct irradiance of the wall at points given by their offset from the beam's axis.

    E = -n . V with the wall's inward normal n; zero behind the plane of the tip.

    Args:
        beam: tip and axis; its cone is not used.
        radius: rho, distance of the wall point from the axis, mm.
        angle: angle around the axis, rad.

    Returns:
        E per unit power, 1/mm^2, and the wall points, mm.
    """
    around = directions_across(beam.axis, angle)
    wall = _ahead(beam, surface, radius, around)
    lateral, axial = table(radius=radius, distance=wall.distance)
    vector = lateral[..., None] * around + axial[..., None] * beam.axis
    irradiance = -dot(wall.normal, vector)
    return jnp.where(wall.status == HIT, jnp.maximum(irradiance, 0.0), 0.0), wall.point


def _ahead(beam: Beam, surface: Surface, radius: Array, around: Array) -> Intersection:
    """The wall ahead of places at a distance from the axis, in directions across it."""
    start = beam.tip + radius[..., None] * around
    return surface.intersect(start, jnp.broadcast_to(beam.axis, start.shape))


def half_maximum_contour(
    table: IrradianceTable, beam: Beam, surface: Surface, *, points: int = CONTOUR_POINTS
) -> Float[Array, "n 3"]:
    """Outermost curve on the wall at half of the peak of the direct irradiance.

    Args:
        surface: the wall, Lambertian and uniform.
        points: number of points, uniform in angle around the beam's axis.

    Returns:
        Wall points, mm; without noise, occlusion and indirect light.
    """
    angles = jnp.asarray(generator_angles(points))
    reach = table.envelope(jnp.linalg.norm(beam.spot(surface).distance) * 1.5 + 0.5)
    radii = jnp.linspace(0.0, 1.0, _RADII) * reach
    grid_radius, grid_angle = jnp.meshgrid(radii, angles)
    profile, _ = wall_irradiance(table, beam, surface, radius=grid_radius, angle=grid_angle)
    level = 0.5 * jnp.max(profile)

    def excess(radius: Array) -> Array:
        return wall_irradiance(table, beam, surface, radius=radius, angle=angles)[0] - level

    above = profile >= level
    last = _RADII - 1 - jnp.argmax(above[:, ::-1], axis=-1)
    low, high = radii[last], radii[jnp.minimum(last + 1, _RADII - 1)]
    found = bisected(lambda radius: excess(radius) >= 0, low, high, steps=_BISECTIONS)
    low, high = jax.lax.stop_gradient(found)
    edge = implicit_root(excess, 0.5 * (low + high))
    return wall_irradiance(table, beam, surface, radius=edge, angle=angles)[1]


_RINGS, _DIRECTIONS = 8, 16  # numbers of nodes for smooth light


def enclosed(radius: Float[Array, "*batch"], length: ScalarLike) -> Float[Array, "*batch"]:
    """Share of a point's light that leaves the wall within a radius; P(r) of the module, mm."""
    reach = radius / length
    return 1.0 - (1.0 + reach) * jnp.exp(-reach)


def spread_nodes() -> tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, "n"]]:
    """Quadrature of the kernel for smooth light: offsets in units of L, and weights of sum 1.

    Gauss-Laguerre in the radius, uniform in the angle.
    """
    radii, weights = roots_genlaguerre(_RINGS, 1.0)
    angles = (np.arange(_DIRECTIONS) + 0.5) * (2.0 * np.pi / _DIRECTIONS)
    circle = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    offsets = radii[:, None, None] * circle
    return offsets.reshape(-1, 2), np.repeat(weights / (_DIRECTIONS * weights.sum()), _DIRECTIONS)


_SIDES = 256  # directions in which the cone's edge is looked for
_SPREAD_BISECTIONS = 40
_FARTHEST = 8.0  # largest shift of the contour by spread, in L; 99.7 % of the light is nearer
_PEAK_RADII, _PEAK_ANGLES = 48, 12


class SpreadSpot(NamedTuple):
    """Ellipses of the cone's edge and of half the maximum on a wall that spreads light, px."""

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
        points: on the wall, mm.
        outward: the wall's normals there.
        length: L, mm.
    """
    angle = (np.arange(_SIDES) + 0.5) * (2.0 * np.pi / _SIDES)
    along = directions_across(outward[..., None, :], angle)
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
        length: L, mm.

    Returns:
        Wall points of both, mm; NaN where a light is spread over so much more than the spot that
        there is no such contour.
    """
    around = directions_across(beam.axis, generator_angles(CONTOUR_POINTS))

    def radius_of(points: Float[Array, "n 3"]) -> Float[Array, "n"]:
        return jnp.sum((points - beam.tip) * around, axis=-1)

    def share(radius: Array, around: Array) -> Array:
        wall = _ahead(beam, surface, radius, around)
        return lit_share(beam, wall.point, -wall.normal, length)

    moves = jnp.asarray(np.column_stack(spread_nodes()))

    def light(radius: Array, around: Array) -> Array:
        """Irradiance averaged over the tangent plane's nodes, 1/mm^2 per unit power."""
        if table is None:  # uniform up to its edge, as for `spot_truth`
            return share(radius, around)
        wall = _ahead(beam, surface, radius, around)
        first, second = perpendicular_frame(wall.normal)

        def added(total: Array, move: Array) -> tuple[Array, None]:
            place = wall.point + length * (move[0] * first + move[1] * second) - beam.tip
            distance = dot(place, jnp.broadcast_to(beam.axis, place.shape))
            across = place - distance[..., None] * beam.axis
            radius = jnp.sqrt(dot(across, across))
            lateral, axial = table(radius=radius, distance=distance)
            vector = (lateral / jnp.maximum(radius, 1e-12))[..., None] * across
            vector = vector + axial[..., None] * beam.axis
            return total + move[2] * jnp.maximum(-dot(vector, wall.normal), 0.0), None

        return jax.lax.scan(added, jnp.zeros(wall.point.shape[:-1]), moves)[0]

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
        low, high = bisected(
            lambda radius: value(radius, around) >= level, low, high, steps=_SPREAD_BISECTIONS
        )
        edge = jnp.where(exists, 0.5 * (low + high), jnp.nan)
        return _ahead(beam, surface, edge, around).point

    return contour(share, 0.5, radius_of(edge)), contour(light, level, radius_of(unspread))


def indirect_irradiance(
    *,
    flux: ArrayLike,
    reflectance: ArrayLike,
    eye_radius: ArrayLike,
    pupil_radius: ArrayLike = 0.0,
) -> Float[Array, "*batch"]:
    r"""Indirect irradiance in a sphere with a uniform Lambertian wall, the same everywhere.

    $E = \rho\Phi / (4\pi r^2 (1-\rho(1-f)))$ with $f = (1 - \sqrt{1 - p^2/r^2})/2$, the fraction of
    the sphere's area that the pupil takes (integrating sphere with a port: Jacquez & Kuppenheim
    1955). Each reflection spreads light uniformly over the sphere, and light through the pupil is
    lost, so the sum over reflections is geometric. The formula neglects the instrument's shadow and
    absorption, and any variation of the reflectance around its flux-weighted mean.

    Args:
        flux: power that reaches the wall directly, W.
        reflectance: rho in [0, 1), one value or one per colour channel.
        eye_radius: r, mm.
        pupil_radius: p, radius of the pupil's rim, mm, in [0, r); 0 is closed.

    Returns:
        Irradiance, W/mm^2.

    Example:
        >>> even = indirect_irradiance(flux=1.0, reflectance=0.5, eye_radius=11.5)
        >>> round(float(even), 6)  # W/mm^2
        0.000602
    """
    rho = jnp.asarray(reflectance)
    radius = jnp.asarray(eye_radius)
    opening = 0.5 * (1.0 - jnp.sqrt(1.0 - jnp.square(pupil_radius / radius)))
    return rho * flux / (4.0 * jnp.pi * jnp.square(radius) * (1.0 - rho * (1.0 - opening)))


_BATCH = 16
# A few float64 roundings of coordinates of about 10 mm.
_ROUNDING = 1e-13


class SpotTruth(NamedTuple):
    """Truth of spots, one per beam along the leading axis; mm, px, rad.

    Attributes:
        beam: tip, axis and cone.
        status: status of the intersection of axis and wall; the rest is valid only if it is HIT.
        distance: d = |SO|.
        nearest: distance from the tip to the nearest wall point.
        origin: O on the wall.
        eccentricity: c, distance of O from the microscope's axis.
        azimuth: azimuth of O around that axis; 0 if O is on it.
        incidence: angle between the beam and the outward normal at O.
        incidence_azimuth: as in `beam_at_spot`; 0 at perpendicular incidence.
        cone: ellipse of the cone's edge in the image.
        half_max: ellipse of the half-maximum contour in the image.
        contour: the half-maximum contour on the wall.
    """

    beam: Beam
    status: Int[Array, "n"]
    distance: Float[Array, "n"]
    nearest: Float[Array, "n"]
    origin: Float[Array, "n 3"]
    eccentricity: Float[Array, "n"]
    azimuth: Float[Array, "n"]
    incidence: Float[Array, "n"]
    incidence_azimuth: Float[Array, "n"]
    cone: Ellipse
    half_max: Ellipse
    contour: Float[Array, "n points 3"]
    contour_px: Float[Array, "n points 2"]


def spot_truth(
    surface: Surface,
    microscope: Camera,
    table: IrradianceTable | None,
    *,
    tip: Float[ArrayLike, "n 3"],
    axis: Float[ArrayLike, "n 3"],
    half_angle: ScalarLike,
    apex_offset: ScalarLike,
) -> SpotTruth:
    """Truth of many beams that differ in tip and axis.

    The ideal cone is uniform up to its edge, so without a table the half-maximum contour is the
    cone's edge.

    Args:
        table: vector irradiance of a lens, or None for the ideal cone.
        tip: S, mm, eye frame.
        axis: unit vectors from the tip towards the wall.
        half_angle: of the cone, rad.
        apex_offset: b, mm.
    """
    poses = np.concatenate([np.asarray(tip, float), np.asarray(axis, float)], axis=1)
    # As arrays, so that one compilation is valid for every trial.
    cone = jnp.asarray(half_angle, float), jnp.asarray(apex_offset, float)
    truth = partial(_truth, surface, microscope, table, *cone)
    return jax.tree.map(jnp.asarray, in_batches(truth, poses, size=_BATCH))


@eqx.filter_jit
def _truth(
    surface: Surface,
    microscope: Camera,
    table: IrradianceTable | None,
    half_angle: Float[Array, ""],
    apex_offset: Float[Array, ""],
    poses: Float[ArrayLike, "n 6"],
) -> SpotTruth:
    def of(pose: Float[Array, "6"]) -> SpotTruth:
        beam = Beam(tip=pose[:3], axis=pose[3:], half_angle=half_angle, apex_offset=apex_offset)
        edge = cone_contour(beam, surface).point
        contour = edge if table is None else half_maximum_contour(table, beam, surface)
        spot = beam.spot(surface)
        eccentricity, azimuth = _polar(spot.point[0], spot.point[1])
        frame = surface.frame_at(eccentricity=eccentricity, azimuth=azimuth)
        lean, incidence_azimuth = _polar(
            jnp.dot(beam.axis, frame.meridional), jnp.dot(beam.axis, frame.azimuthal)
        )
        images = microscope.project(jnp.stack([edge, contour]))
        ellipses = ellipse_of_contour(images)
        return SpotTruth(
            beam=beam,
            status=spot.status,
            distance=spot.distance,
            nearest=surface.nearest_distance(beam.tip),
            origin=spot.point,
            eccentricity=eccentricity,
            azimuth=azimuth,
            incidence=jnp.arctan2(lean, jnp.dot(beam.axis, frame.outward)),
            incidence_azimuth=incidence_azimuth,
            cone=jax.tree.map(itemgetter(0), ellipses),
            half_max=jax.tree.map(itemgetter(1), ellipses),
            contour=contour,
            contour_px=images[1],
        )

    return jax.vmap(of)(jnp.asarray(poses))


def _polar(x: Float[Array, ""], y: Float[Array, ""]) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """Radius and angle, both 0 if the radius is only a rounding error."""
    radius = jnp.hypot(x, y)
    zero = radius < _ROUNDING
    return jnp.where(zero, 0.0, radius), jnp.where(zero, 0.0, jnp.arctan2(y, x))
