"""The error of every model split by cause, so that the parts sum to the whole.

The players are the five `LINKS` of a chain, and five more: what a rendered frame adds to e1' at its
edge (half-maximum, falling light, texture, shadow; seen without noise at twice the resolution) and
by pixels and noise (the rest), what the wall does by spreading the light, and a wrong r and a wrong
c that the models are given. The worth of a set of players is a model's error when they are real and
the others ideal; it is computed for all 1,024 sets, so Shapley's values are exact.

Edge, pixels and spread are differences of e1' in px, taken once for each geometry, in the real
world, and added in every other as they are: what noise and edges do to a contour depends on its
size and light, which the geometric links change by a few per cent.
"""

from dataclasses import replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
from jaxtyping import Array, Float

from eyespot import optics
from eyespot.benchmarks.model_error import Geometry, place, readings
from eyespot.benchmarks.statistics import coalitions, shapley_values
from eyespot.optics.irradiance import in_batches
from eyespot.optics.viewing import load_eye
from eyespot.scenes import Scene
from eyespot.scenes.walls.picture import PRESETS_MM, wall_spread

# The chain from a distance to a spot's size and back, each link of which can be real or ideal.
#
# Ideal throughout, the chain is the planar model's world: a beam square to a flat wall that faces
# the microscope at the pole's height, e1' = (d - b)/(k delta). Each link that is switched on brings
# in one thing that a real eye has. A model undoes what its own terms are for; with a link off, the
# term that the model has for it is off too, so every model is right when all links are ideal, and
# what a link adds to the error is what the model leaves of it.

LINKS = (
    "foreshortening",
    "magnification with depth",
    "sagitta",
    "ellipse fit of a non-ellipse",
    "beam not square",
)
_POINTS = 64
"""Of a contour; the test against `optics`, which takes 128, shows that they are enough."""

_SECANT_STEPS = 5


_Switch = Float[Array, ""] | bool


class Links(NamedTuple):
    """Which links of the chain are real: True or False each."""

    # The wall is inclined by phi against the image; the paper's cos(phi) is a term for it.
    foreshortening: _Switch
    magnification: _Switch  # grows towards the pinhole; without it the microscope is telecentric
    sagitta: _Switch  # the wall is a sphere, not its tangent plane
    ellipse_fit: _Switch  # e1' is that of the fitted ellipse, not half of the contour's width
    incidence: _Switch  # the beam is inclined, not square to the wall


REAL = Links(*(True for _ in LINKS))


def semi_minor(
    eye: Geometry, c: Float[Array, ""], distance: Float[Array, ""], links: Links = REAL
) -> Float[Array, ""]:
    """e1' of the spot's contour at c and at a distance (mm) along the beam, px."""
    contour = _contour(eye, c, distance, links)
    ellipse = optics.ellipse_of_contour(contour)
    # Half of the contour's width across its longer axis.
    turn = ellipse.angle + 0.5 * jnp.pi
    along = contour @ jnp.stack([jnp.cos(turn), jnp.sin(turn)])
    across = 0.5 * (_greatest(along) + _greatest(-along))
    return jnp.where(links.ellipse_fit, ellipse.semi_minor, across)


def distances(
    believed: Geometry, c: Float[Array, ""], semi_minor_px: Float[Array, ""], links: Links = REAL
) -> dict[str, Float[Array, ""]]:
    """Distance by every model, mm, from e1' (px) seen through these links.

    `believed` and c are the geometry as the models take it; their terms are switched with the
    links.
    """
    # The stereographic formula is exact for a square beam and a pinhole on the sphere.
    special: dict[str, Any] = {"pinhole_height": believed.eye_radius, "incidence": 0.0}
    both = jax.tree.map(lambda *v: jnp.stack(v), believed._replace(**special), believed)
    stereographic, exact = jax.vmap(lambda eye: inverse(eye, c, semi_minor_px, links))(both)
    k, b = optics.slope(believed.half_angle), believed.apex_offset
    radius = believed.eye_radius
    kappa = jnp.where(links.magnification, 1.0 / (believed.pinhole_height + radius), 0.0)
    cos_phi = optics.paper_foreshortening(eccentricity=c, eye_radius=radius)
    curved = jnp.where(links.sagitta, radius, jnp.inf)
    spot = believed.scale * semi_minor_px

    def on_sphere(factor: Float[Array, ""]) -> Float[Array, ""]:
        return optics.sphere_distance(spot_radius=spot * factor, k=k, b=b, eye_radius=curved)

    factor = optics.corrected_factor(
        eccentricity=c, eye_radius=radius, inverse_working_distance=kappa
    )
    # On a wall that faces the microscope only the height counts.
    upright = 1.0 - kappa * radius * (1.0 - cos_phi)
    return {
        "planar": optics.planar_distance(
            semi_minor_px=semi_minor_px, scale=believed.scale, k=k, b=b
        ),
        "small_plane": on_sphere(jnp.where(links.foreshortening, cos_phi, 1.0)),
        "corrected": on_sphere(jnp.where(links.foreshortening, factor, upright)),
        "stereographic": stereographic,
        "exact": exact,
    }


def inverse(
    eye: Geometry, c: Float[Array, ""], semi_minor_px: Float[Array, ""], links: Links = REAL
) -> Float[Array, ""]:
    """Distance at which the chain gives a semi-minor axis, mm.

    e1' all but scales with the distance from the apex, so rescaling that distance is a
    contraction (`optics.exact_distance` repeats it); the secant through two of its steps gains the
    product of their errors instead.
    """
    apex = eye.apex_offset

    def secant(step: int, state: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        before, miss_before, reach = state
        miss = reach * semi_minor_px / semi_minor(eye, c, reach + apex, links) - reach
        change = miss - miss_before
        # The first step has no secant yet, and a settled distance has none any more.
        plain = (step == 0) | (change == 0)
        gain = -miss * (reach - before) / jnp.where(plain, 1.0, change)
        return reach, miss, reach + jnp.where(plain, miss, gain)

    planar = eye.scale * semi_minor_px / jnp.tan(eye.half_angle)
    start = planar, jnp.zeros_like(planar), planar
    _, _, reach = jax.lax.fori_loop(0, _SECANT_STEPS, secant, start)
    return reach + apex


def _contour(
    eye: Geometry, c: Float[Array, ""], distance: Float[Array, ""], links: Links
) -> Float[Array, "n 2"]:
    """Image of the spot's edge, px; the meridian of O is the x axis."""
    seen: dict[str, Any] = {
        "pinhole_height": jnp.where(links.magnification, eye.pinhole_height, jnp.inf),
        "incidence": jnp.where(links.incidence, eye.incidence, 0.0),
    }
    eye = eye._replace(**seen)
    sphere, view = eye.world
    # Without foreshortening the spot is the one at the pole, moved to O without turning it.
    at = jnp.where(links.foreshortening, c, 0.0)
    beam = optics.beam_at_spot(sphere, eccentricity=at, distance=distance, **eye.beam)
    here, there = (sphere.frame_at(eccentricity=of, azimuth=0.0) for of in (at, c))
    tangent = optics.Plane(point=here.origin, inward=-here.outward)
    curved, flat = (
        optics.cone_contour(beam, wall, points=_POINTS).point for wall in (sphere, tangent)
    )
    edge = jnp.where(links.sagitta, curved, flat) + there.origin - here.origin
    return view.project(edge)


def _greatest(periodic: Float[Array, "n"]) -> Float[Array, ""]:
    """Greatest value of a periodic sequence, also between its samples.

    A sinusoid goes through the greatest sample and its neighbours: right for every ellipse.
    """
    before, at, after = (jnp.roll(periodic, 1 - jnp.argmax(periodic))[i] for i in range(3))
    step = 2.0 * jnp.pi / _POINTS
    cosine = (at - 0.5 * (before + after)) / (1.0 - jnp.cos(step))
    sine = 0.5 * (after - before) / jnp.sin(step)
    return at - cosine + jnp.hypot(cosine, sine)


CAUSES = (
    *LINKS,
    "edge and radiometry",
    "pixels and noise",
    "light spread in the wall",
    "wrong r",
    "wrong c",
)
WRONG_R_MM = 0.5  # given too large: the paper's r is 11 mm or 11.5 mm
WRONG_C_MM = 0.5  # given too large: an eye half a millimetre off the microscope's axis
_AT_A_TIME = 4


def spread_length(scene: Scene) -> float:
    """L of the scene's wall in green, mm; that of printed paper if the scene's spreads nothing."""
    own = wall_spread(scene.phantom)
    return float(PRESETS_MM["printed paper"][1] if own is None else own[1])


def spread_shift(geometry: Geometry, *, c: np.ndarray, d: np.ndarray, length: float) -> np.ndarray:
    """What light spread by L (mm) in the wall adds to e1' of the cone's half-maximum contour, px.

    At n eccentricities and distances, mm.
    """
    wall, camera = geometry.world

    def beam(c: jax.Array, d: jax.Array) -> optics.Beam:
        return optics.beam_at_spot(wall, eccentricity=c, distance=d, **geometry.beam)

    # In parts of one size, so that one compilation serves every trial.
    padded = (np.pad(a, (0, -len(a) % _AT_A_TIME), mode="edge") for a in (c, d))
    beams = jax.vmap(beam)(*map(jnp.asarray, padded))
    spread = optics.spread_spots(wall, camera, None, beams, length).half_max.semi_minor
    sharp = jax.vmap(lambda beam: optics.spot_ellipse(beam, wall, camera).semi_minor)(beams)
    return np.asarray(spread - sharp)[: len(c)]


def shares(
    geometry: Geometry, *, medium: str, c: np.ndarray, d: np.ndarray, shift: np.ndarray
) -> pd.DataFrame:
    """Content of causes.csv: errors of all models at n eccentricities and distances by cause, mm.

    `whole_mm` is the error with all causes, to which the parts of a geometry sum. `shift` is what
    rendering adds to e1', px, 3 x n: by the edge and its light, by pixels and noise, and by a wall
    that spreads light.
    """
    worth = worths(geometry, c=c, d=d, shift=shift)
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


def worths(geometry: Geometry, *, c: np.ndarray, d: np.ndarray, shift: np.ndarray) -> np.ndarray:
    """Error of every model with every set of causes, mm: n x models x 1,024."""
    spots = c, d, shift.T
    return np.asarray(in_batches(lambda of: _worths(geometry, *of), spots, size=_AT_A_TIME))


@jax.jit
def _worths(
    geometry: Geometry, c: Float[Array, "n"], d: Float[Array, "n"], shift: Float[Array, "n 3"]
) -> Float[Array, "n models sets"]:
    sets = jnp.asarray(coalitions(len(CAUSES)))

    def of(c: Array, d: Array, shift: Array) -> Float[Array, "models sets"]:
        return jax.vmap(lambda one: _model_errors(geometry, c, d, shift, one), out_axes=1)(sets)

    return jax.vmap(of)(c, d, shift)


def _model_errors(
    eye: Geometry,
    c: Float[Array, ""],
    d: Float[Array, ""],
    shift: Float[Array, "3"],
    causes: Float[Array, "10"],
) -> Float[Array, "models"]:
    """Every model's error with one set of causes, mm."""
    links = Links(*causes[: len(LINKS)])
    *shifted, r_on, c_on = causes[len(LINKS) :]
    seen = semi_minor(eye, c, d, links) + jnp.stack(shifted) @ shift
    larger = r_on * WRONG_R_MM
    wrong: dict[str, Any] = {
        "eye_radius": eye.eye_radius + larger,
        # The working distance is the microscope's, so it does not change with the wrong r.
        "pinhole_height": eye.pinhole_height - larger,
    }
    found = distances(eye._replace(**wrong), c + c_on * WRONG_C_MM, seen, links)
    return jnp.stack([found[model] for model in optics.MODELS]) - d


# What a living eye adds: its retina is no sphere, and a clear layer lies over the wall.

EYE_C_MM = (1.0, 3.0, 5.0)
LEAN_DEG, ASIDE_MM = 8.0, 0.5
"""Tilt and shift of the retina's ellipsoid against the microscope's axis."""
LAYER_MM = (0.2, 0.3)
"""Thickness of the clear retina over the layer that sends the light back."""
_SPHERE_RADIUS_MM = 11.5  # It stands for the ellipsoid.
_EYE_DISTANCES_MM = (0.5, 2.0, 4.0, 6.0)


def of_an_eye(geometry: Geometry) -> pd.DataFrame:
    """Content of eye.csv: errors of `exact` in a living eye, mm, at `EYE_C_MM`.

    Columns: z_f_mm; `shape_mm`, the largest |error| over d and directions on Atchison's (2006)
    emmetropic ellipsoid, scaled to the geometry's radius; `tilted_mm`, the same on one that is
    tilted and shifted.
    """
    semi_axes = load_eye("atchison").retina_semi_axes * geometry.eye_radius / _SPHERE_RADIUS_MM
    azimuths = np.radians(np.arange(0.0, 360.0, 30.0))
    grid = np.meshgrid(EYE_C_MM, azimuths, _EYE_DISTANCES_MM, indexing="ij")
    c, azimuth, d = (axis.ravel() for axis in grid)

    def largest(lean_deg: float, aside_mm: float) -> np.ndarray:
        placed = semi_axes, np.radians(lean_deg), aside_mm
        seen = np.asarray(_on_ellipsoid(geometry, *placed, c, azimuth, d))
        read = readings(geometry, ("exact",), c=c, semi_minor_px=seen)["exact"]
        return np.abs(read - d).reshape(len(EYE_C_MM), -1).max(axis=1)

    tilted = [largest(LEAN_DEG, aside) for aside in (ASIDE_MM, -ASIDE_MM)]
    at = {"z_f_mm": geometry.pinhole_height, "c_mm": EYE_C_MM}
    return pd.DataFrame({**at, "shape_mm": largest(0.0, 0.0), "tilted_mm": np.max(tilted, axis=0)})


@jax.jit
def _on_ellipsoid(
    geometry: Geometry,
    semi_axes: Array,
    lean: Array,
    aside: Array,
    c: Array,
    azimuth: Array,
    d: Array,
) -> Float[Array, "n"]:
    """e1' of spots on an ellipsoid whose pole is where the sphere's is, px."""
    view = replace(geometry.world[1], pole_height=-semi_axes[2])
    wall = optics.Ellipsoid(semi_axes, shift=(aside, 0.0), tilt=lean)

    def seen(c: Array, azimuth: Array, d: Array) -> Array:
        place = {"eccentricity": c, "azimuth": azimuth, "distance": d}
        beam = optics.beam_at_spot(wall, **place, **geometry.beam)
        return optics.spot_ellipse(beam, wall, view).semi_minor

    return jax.vmap(seen)(c, azimuth, d)
