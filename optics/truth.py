"""The true parameters of a beam's spot, for labels."""

from __future__ import annotations

from operator import itemgetter
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float, Int, ScalarLike

from optics.beam import Beam
from optics.camera import Camera
from optics.contour import cone_contour
from optics.ellipse import Ellipse, ellipse_of_contour
from optics.half_maximum import half_maximum_contour
from optics.irradiance_lookup import IrradianceTable
from optics.surface import Surface

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
        contour_px: its image.
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
        surface: the wall.
        microscope: the camera.
        table: vector irradiance of a lens, or None for the ideal cone.
        tip: S, mm, eye frame.
        axis: unit vectors from the tip towards the wall.
        half_angle: of the cone, rad.
        apex_offset: b, mm.
    """
    poses = np.concatenate([np.asarray(tip, float), np.asarray(axis, float)], axis=1)
    # As arrays, and in parts of one size, so that one compilation is valid for every trial.
    cone = jnp.asarray(half_angle, float), jnp.asarray(apex_offset, float)
    filled = np.pad(poses, ((0, -len(poses) % _BATCH), (0, 0)), mode="edge")
    parts = [
        _truth(surface, microscope, table, jnp.asarray(part), cone)
        for part in filled.reshape(-1, _BATCH, 6)
    ]
    return jax.tree.map(lambda *leaves: jnp.concatenate(leaves)[: len(poses)], *parts)


@eqx.filter_jit
def _truth(
    surface: Surface,
    microscope: Camera,
    table: IrradianceTable | None,
    poses: Float[Array, "n 6"],
    cone: tuple[Float[Array, ""], Float[Array, ""]],
) -> SpotTruth:
    half_angle, apex_offset = cone

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

    return jax.vmap(of)(poses)


def _polar(x: Float[Array, ""], y: Float[Array, ""]) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """Radius and angle, both 0 if the radius is only a rounding error."""
    radius = jnp.hypot(x, y)
    zero = radius < _ROUNDING
    return jnp.where(zero, 0.0, radius), jnp.where(zero, 0.0, jnp.arctan2(y, x))
