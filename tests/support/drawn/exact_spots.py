"""Spots of cones by the exact geometry of `optics`: one program for a kind of wall and camera."""

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from eyespot import optics
from eyespot.calibration.least_squares import padded
from eyespot.calibration.spots.cone_trials import ConeTrial

Place = tuple[float, float, float, float, float]
"""Eccentricity (mm), azimuth, incidence, its azimuth (rad) and distance (mm) of a beam's spot."""
_TOGETHER = 16  # Rows that a batch is padded to, so that batches of nearly equal length share one.


def exact_spots(
    wall: optics.Surface,
    camera: optics.Camera,
    places: Sequence[Place],
    *,
    half_angle: float = np.arctan(1 / 20),
    b: float = -5.117,
) -> tuple[optics.Ellipse, Any]:
    """Ellipses (px) of the spots of beams at n places, and the beams, both of NumPy's arrays."""
    count = len(places)
    rows = jnp.asarray(padded(np.array(places, float), count + -count % _TOGETHER))
    found = _seen(wall, camera, rows, jnp.asarray(half_angle), jnp.asarray(b))
    ellipses, beams = jax.tree.map(lambda leaf: np.asarray(leaf)[:count], found)
    return ellipses, beams


def with_errors(ellipses: optics.Ellipse, errors: np.ndarray) -> optics.Ellipse:
    """Ellipses with errors of their centres, axes and angles, n x 5."""
    shape = (of + error for of, error in zip(ellipses[1:], errors.T[2:], strict=True))
    return optics.Ellipse(ellipses.centre + errors[:, :2], *shape)


def cone_trial(ellipses: optics.Ellipse, covariances: np.ndarray, **known: Any) -> ConeTrial:
    """A withdrawal whose contours are whole, about the principal point; one or n covariances."""
    count = len(ellipses.centre)
    usual: dict[str, Any] = {"principal_point": np.zeros(2), "kind": "eyeball"}
    each = np.broadcast_to(covariances, (count, 5, 5))
    whole = np.ones(count)
    return ConeTrial(ellipses=ellipses, covariances=each, coverage=whole, **usual | known)


@eqx.filter_jit
def _seen(
    wall: optics.Surface, camera: optics.Camera, places: Array, half_angle: Array, b: Array
) -> tuple[optics.Ellipse, optics.Beam]:
    def one(place: Array) -> tuple[optics.Ellipse, optics.Beam]:
        c, azimuth, incidence, towards, distance = place
        beam = optics.beam_at_spot(
            wall,
            eccentricity=c,
            azimuth=azimuth,
            incidence=incidence,
            incidence_azimuth=towards,
            distance=distance,
            half_angle=half_angle,
            apex_offset=b,
        )
        return optics.spot_ellipse(beam, wall, camera), beam

    return jax.vmap(one)(places)
