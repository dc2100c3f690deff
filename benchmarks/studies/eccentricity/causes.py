"""The error of every model split by cause, so that the parts sum to the whole.

The players are the five links of `chain`, and five more: what a rendered frame adds to e1' at its
edge (half-maximum, falling light, texture, shadow; seen without noise at twice the resolution) and
by pixels and noise (the rest), what the wall does by spreading the light, and a wrong r and a wrong
c that the models are given. The worth of a set of players is a model's error when they are real and
the others ideal; it is computed for all 1,024 sets, so Shapley's values are exact.

Edge, pixels and spread are differences of e1' in px, taken once for each geometry, in the real
world, and added in every other as they are: what noise and edges do to a contour depends on its
size and light, which the geometric links change by a few per cent.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
from jaxtyping import Array, Float

import optics
from benchmarks.evaluation import Geometry, coalitions, place, shapley_values
from benchmarks.studies.eccentricity import chain
from benchmarks.studies.eccentricity.chain import LINKS, Eye, Links
from scenes import Scene
from scenes.walls import PRESETS_MM, wall_spread

CAUSES = (
    *LINKS,
    "edge and radiometry",
    "pixels and noise",
    "light spread in the wall",
    "wrong r",
    "wrong c",
)
"""The players, in order."""

WRONG_R_MM = 0.5
"""Given too large: the paper's r is 11 mm or 11.5 mm."""

WRONG_C_MM = 0.5
"""Given too large: an eye half a millimetre off the microscope's axis."""

_BATCH = 4


class Shift(NamedTuple):
    """What rendering adds to e1' of spots, px.

    Attributes:
        edge: by the edge and its light.
        spread: by a wall that spreads light.
    """

    edge: np.ndarray
    pixels: np.ndarray
    spread: np.ndarray


def spread_length(scene: Scene) -> float:
    """L of the scene's wall in green, mm; that of printed paper if the scene's spreads nothing."""
    own = wall_spread(scene.phantom)
    return float(PRESETS_MM["printed paper"][1] if own is None else own[1])


def spread_shift(geometry: Geometry, *, c: np.ndarray, d: np.ndarray, length: float) -> np.ndarray:
    """What light spread in the wall adds to e1' of the cone's half-maximum contour, px.

    Args:
        c: n eccentricities, mm.
        d: n distances, mm.
        length: L, mm.
    """
    wall = optics.Sphere(geometry.eye_radius)
    camera = optics.microscope(
        scale=geometry.scale,
        pinhole_height=geometry.pinhole_height,
        eye_radius=geometry.eye_radius,
    )

    def beam(c: jax.Array, d: jax.Array) -> optics.Beam:
        return optics.beam_at_spot(
            wall,
            eccentricity=c,
            distance=d,
            incidence=geometry.incidence,
            incidence_azimuth=geometry.incidence_azimuth,
            half_angle=geometry.half_angle,
            apex_offset=geometry.apex_offset,
        )

    # In parts of one size, so that one compilation serves every trial.
    padded = (np.pad(a, (0, -len(a) % _BATCH), mode="edge") for a in (c, d))
    beams = jax.vmap(beam)(*map(jnp.asarray, padded))
    spread = optics.spread_spots(wall, camera, None, beams, length).half_max.semi_minor
    sharp = jax.vmap(lambda beam: optics.spot_ellipse(beam, wall, camera).semi_minor)(beams)
    return np.asarray(spread - sharp)[: len(c)]


def shares(
    geometry: Geometry, *, medium: str, c: np.ndarray, d: np.ndarray, shift: Shift
) -> pd.DataFrame:
    """Content of causes.csv: the errors of all models at eccentricities and distances by cause, mm.

    `whole_mm` is the error with all causes, to which the parts of a geometry sum.

    Args:
        c: n eccentricities, mm.
        d: n distances, mm.
        shift: what rendering adds, n each.
    """
    worth = worths(eyes(geometry, c=c), d=d, shift=shift)
    values = shapley_values(worth)
    spot, m, p = (index.ravel() for index in np.indices(values.shape))
    return pd.DataFrame(
        {
            "model": np.array(optics.MODELS)[m],
            "cause": np.array(CAUSES)[p],
            "medium": medium,
            **place(geometry, c=c[spot], d=d[spot]),
            "part_mm": values.ravel(),
            "whole_mm": worth[spot, m, -1],
        }
    )


def eyes(geometry: Geometry, *, c: np.ndarray) -> Eye:
    """The geometry at each eccentricity (mm) as the chain takes it: arrays of n."""
    r = geometry.eye_radius
    shared = {
        "scale": geometry.scale,
        "inverse_working_distance": 1.0 / (geometry.pinhole_height + r),
        "radius": r,
        "half_angle": geometry.half_angle,
        "apex_offset": geometry.apex_offset,
        "incidence": geometry.incidence,
        "incidence_azimuth": geometry.incidence_azimuth,
        "eccentricity": c,
    }
    return Eye(**{n: jnp.broadcast_to(jnp.asarray(v, float), c.shape) for n, v in shared.items()})


def worths(eye: Eye, *, d: np.ndarray, shift: Shift) -> np.ndarray:
    """Error of every model with every set of causes, mm: n x models x 1,024."""
    columns = [np.asarray(column, float) for column in (*eye, d, *shift)]
    # In parts of one size, so that one compilation serves every trial.
    filled = np.pad(np.stack(columns), ((0, 0), (0, -len(d) % _BATCH)), mode="edge")
    parts = np.split(filled, filled.shape[1] // _BATCH, axis=1)
    return np.concatenate([np.asarray(_worths(jnp.asarray(part))) for part in parts])[: len(d)]


@jax.jit
def _worths(columns: Float[Array, "columns n"]) -> Float[Array, "n models sets"]:
    sets = jnp.asarray(coalitions(len(CAUSES)))

    def of(spot: Float[Array, "columns"]) -> Float[Array, "models sets"]:
        *eye, d, edge, pixels, spread = spot
        shift = jnp.stack([edge, pixels, spread])
        return jax.vmap(lambda causes: _errors(Eye(*eye), d, shift, causes), out_axes=1)(sets)

    return jax.vmap(of, in_axes=1)(columns)


def _errors(
    eye: Eye,
    d: Float[Array, ""],
    shift: Float[Array, "3"],
    causes: Float[Array, "10"],
) -> Float[Array, "models"]:
    """Every model's error with one set of causes, mm."""
    links = Links(*causes[: len(LINKS)])
    *shifted, r_on, c_on = causes[len(LINKS) :]
    seen = chain.semi_minor(eye, d, links) + jnp.stack(shifted) @ shift
    # The working distance is the microscope's, so it does not change with the wrong r.
    believed = eye._replace(
        radius=eye.radius + r_on * WRONG_R_MM, eccentricity=eye.eccentricity + c_on * WRONG_C_MM
    )
    found = chain.distances(believed, seen, links)
    return jnp.stack([found[model] for model in optics.MODELS]) - d
