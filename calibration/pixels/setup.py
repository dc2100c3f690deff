"""What a fit starts from: its constants, start values and priors."""

from __future__ import annotations

from collections.abc import Mapping

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

import optics
from calibration.pixels.chunks import Problem
from calibration.pixels.data import Footage
from calibration.pixels.parameters import DEFAULTS, NUISANCES
from calibration.spots import Prior, phantom_wall

_TOUCH_SIGMA_MM = 0.02


def fit_problem(
    footage: Footage,
    start: Mapping[str, float],
    free: tuple[str, ...],
    priors: Mapping[str, Prior],
    *,
    place: Float[np.ndarray, "2"],
    lean_sigma: float,
    boresight_sigma: float,
) -> tuple[Problem, dict[str, Prior]]:
    """The problem and its priors, given ones included.

    Args:
        footage: the frames.
        start: start values of free parameters, and values of others.
        free: names of the free parameters; the nuisances are free too.
        priors: priors that replace or add to those of the nuisances.
        place: centre of the spot, px.
        lean_sigma: standard deviation of the robot's directions, rad.
        boresight_sigma: standard deviation of the beam's angle from the tool's axis, rad.
    """
    file = footage.microscope
    microscope = optics.microscope(
        scale=file.scale_mm_px,
        pinhole_height=file.pinhole_height_mm,
        eye_radius=file.eye_radius_mm,
        principal_point=file.principal_point_px,
        distortion=tuple(file.distortion),
    )
    surface = phantom_wall(footage.kind, eye_radius=file.eye_radius_mm)
    normal = surface.intersect(*microscope.ray(place)).normal
    # The rim of a tilted tip touches the wall before the centre does.
    touch = optics.contact_distance(
        surface,
        incidence=jnp.arccos(-normal @ footage.axis),
        rim_radius=footage.instrument.fibre_radius,
    )
    lean, boresight = Prior(0.0, lean_sigma), Prior(0.0, boresight_sigma)
    every = {
        "touch": Prior(float(touch), _TOUCH_SIGMA_MM),
        "lean": lean,
        "lean_sideways": lean,
        "boresight": boresight,
        "boresight_sideways": boresight,
        **priors,
    }
    known = dict.fromkeys(NUISANCES, 0.0) | DEFAULTS
    known |= {"scale": file.scale_mm_px, "eye_radius": file.eye_radius_mm}
    known |= {"u": float(place[0]), "v": float(place[1])}
    known |= {name: prior.mean for name, prior in every.items()} | dict(start)
    names = (*free, *(name for name in NUISANCES if name not in free))
    problem = Problem(
        first=jnp.array([known[name] for name in names]),
        size=jnp.array([_size(name, known[name], every) for name in names]),
        fixed={name: jnp.asarray(v, float) for name, v in known.items() if name not in names},
        microscope=microscope,
        motion=jnp.asarray(footage.motion),
        axis=jnp.asarray(footage.axis),
        blur=None,
        names=names,
        kind=footage.kind,
    )
    return problem, every


def _size(name: str, value: float, priors: Mapping[str, Prior]) -> float:
    """Scale of a parameter; with it, the damping affects all parameters equally."""
    if name in priors:
        return priors[name].sigma
    own = {"u": 1.0, "v": 1.0, "illumination": 0.01}
    return own.get(name) or abs(value) or 1.0
