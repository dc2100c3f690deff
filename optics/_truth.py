"""What is true of a spot at each distance of a trial: the numbers behind every label."""

from __future__ import annotations

from operator import itemgetter
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float, ScalarLike

from optics._beam import Beam, beam_at_spot
from optics._camera import Microscope
from optics._contour import cone_contour
from optics._ellipse import Ellipse, ellipse_of_contour
from optics._half_maximum import half_maximum_contour
from optics._irradiance_table import IrradianceTable
from optics._surface import Surface

_BATCH = 16


class SpotTruth(NamedTuple):
    """Truth of a spot; the leading axis runs over distances; mm, px, rad.

    Attributes:
        beam: tip, axis and cone.
        distance: d = |SO|.
        nearest: distance from the tip to the nearest wall point.
        origin: O on the wall.
        cone: ellipse of the cone's edge in the image.
        half_max: ellipse of half of the direct peak in the image.
        contour: the half-maximum contour on the wall.
        contour_px: its image.
    """

    beam: Beam
    distance: Float[Array, "n"]
    nearest: Float[Array, "n"]
    origin: Float[Array, "n 3"]
    cone: Ellipse
    half_max: Ellipse
    contour: Float[Array, "n points 3"]
    contour_px: Float[Array, "n points 2"]


def spot_truth(
    surface: Surface,
    microscope: Microscope,
    table: IrradianceTable | None,
    *,
    distances: Float[ArrayLike, "n"],
    eccentricity: ScalarLike,
    azimuth: ScalarLike,
    incidence: ScalarLike,
    incidence_azimuth: ScalarLike,
    half_angle: ScalarLike,
    apex_offset: ScalarLike,
) -> SpotTruth:
    """Truth at each distance along a beam that keeps its axis.

    The ideal cone is evenly bright up to its edge, so without a table the half-maximum contour
    is the cone's edge.

    Args:
        surface: the wall.
        microscope: the camera.
        table: vector irradiance of a lens, or None for the ideal cone.
        distances: d, mm.
        eccentricity: c of O, mm.
        azimuth: of O, rad.
        incidence: angle between the beam and the outward normal at O, rad.
        incidence_azimuth: as `beam_at_spot`, rad.
        half_angle: of the cone, rad.
        apex_offset: b, mm.
    """
    given = {
        "eccentricity": eccentricity,
        "azimuth": azimuth,
        "incidence": incidence,
        "incidence_azimuth": incidence_azimuth,
        "half_angle": half_angle,
        "apex_offset": apex_offset,
    }
    # As arrays, and in parts of one size, so that one compilation serves every trial.
    pose = {name: jnp.asarray(value, float) for name, value in given.items()}
    wanted = np.asarray(distances, float)
    filled = np.pad(wanted, (0, -wanted.size % _BATCH), mode="edge")
    parts = [
        _truth(surface, microscope, table, jnp.asarray(part), pose)
        for part in filled.reshape(-1, _BATCH)
    ]
    return jax.tree.map(lambda *leaves: jnp.concatenate(leaves)[: wanted.size], *parts)


@eqx.filter_jit
def _truth(
    surface: Surface,
    microscope: Microscope,
    table: IrradianceTable | None,
    distances: Float[Array, "n"],
    pose: dict[str, Float[Array, ""]],
) -> SpotTruth:
    def at(distance: Float[Array, ""]) -> SpotTruth:
        beam = beam_at_spot(surface, distance=distance, **pose)
        edge = cone_contour(beam, surface).point
        contour = edge if table is None else half_maximum_contour(table, beam, surface)
        spot = beam.spot(surface)
        images = microscope.project(jnp.stack([edge, contour]))
        ellipses = ellipse_of_contour(images)
        return SpotTruth(
            beam=beam,
            distance=spot.distance,
            nearest=surface.nearest_distance(beam.tip),
            origin=spot.point,
            cone=jax.tree.map(itemgetter(0), ellipses),
            half_max=jax.tree.map(itemgetter(1), ellipses),
            contour=contour,
            contour_px=images[1],
        )

    return jax.vmap(at)(distances)
