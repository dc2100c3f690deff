"""Recipes: what a person calibrates at the table, and how a distance is then computed."""

from __future__ import annotations

import math
from enum import StrEnum

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

import optics
from benchmarks.studies.eye.geometry import (
    CONE,
    NOMINAL_RADIUS_MM,
    SCALE_MM_PX,
    Pinhole,
    Seen,
    Spots,
    in_batches,
)
from calibration.solvers import gauss_newton_in_blocks
from calibration.spots import NUISANCES, RETINA, SIZE_PER_MM, Group, misfit, whitening_of
from optics.viewing import PathCamera, local_magnification

_SIGMA_PX = 0.1
"""Standard deviation of a measured semi-axis; the sub-pixel mode's RMS on textured walls is 0.05 to
0.1 px (`eyespot validate`)."""
_TOUCH_MM = 0.05
"""Standard deviation of the distance at which a withdrawal starts: the operator's touch."""
_SPOTS_AT_ONCE = 1024

WITHDRAWALS_C_MM = (0.5, 1.5, 3.0)
_TILT_DEG, _TOWARDS_DEG = 25.0, 90.0
"""Of the withdrawals' beams: sideways. Eyes with a gradient lens bend the spots of beams that lean
towards the axis or away from it as no pinhole does."""


class Recipe(StrEnum):
    """Ways to a distance, from what has to be known least to most."""

    PLANAR = "planar"
    """The closed form for a plane; nothing is known of the eye."""

    SMALL_PLANE = "small_plane"
    """The paper's closed form; nothing is known of the eye."""

    STEREOGRAPHIC = "stereographic"
    """The closed form for a pinhole on the sphere; nothing is known of the eye."""

    PARAXIAL = "corrected, paraxial pinhole"
    """`corrected` with the paraxial pinhole of the schematic eye's path."""

    LOCAL = "corrected, schematic eye"
    """`corrected` with the schematic eye's own local magnification."""

    FITTED = "corrected, fitted pinhole"
    """`corrected` with a pinhole and a sphere fitted in this eye."""

    EXACT_SCHEMATIC = "exact, schematic eye"
    """Exact geometry through the schematic eye's surfaces onto its retina, and the ellipse's area.
    """

    AREA_SCHEMATIC = "area, schematic pinhole"
    """Exact geometry and the ellipse's area; pinhole and sphere fitted in the schematic eye."""

    AREA = "area, fitted pinhole"
    """Exact geometry and the ellipse's area; pinhole and sphere fitted in this eye."""


def withdrawals() -> Spots:
    """The spots of the calibration: three withdrawals through a trocar, nine frames each."""
    c, distance = np.meshgrid(WITHDRAWALS_C_MM, np.linspace(1.0, 5.0, 9), indexing="ij")
    tilt, towards = (np.full(c.shape, np.radians(a)) for a in (_TILT_DEG, _TOWARDS_DEG))
    return Spots(*map(jnp.asarray, (c, distance, tilt, towards)))


@eqx.filter_jit
def fitted_pinhole(seen: Seen, noise: Float[Array, "trials frames 5"]) -> Pinhole:
    """Fit a pinhole over a sphere to the ellipses of three withdrawals in one eye.

    As `eyespot fit --model eye`, with the same residuals: the place on the retina is known only
    from the image. Where each withdrawal starts is known to 0.05 mm. The priors of the retina's
    radius and of the spots' sizes are those of the command. The beams' axes and the cone are known
    exactly. Frames whose contour is hidden do not count.

    Args:
        seen: images of `withdrawals()`.
        noise: of centres, semi-major and semi-minor axes and angles, in standard deviations of the
            sub-pixel mode.
    """
    distance, count = withdrawals().distance[0], len(WITHDRAWALS_C_MM)
    # A hidden contour may have no values, and its weight is 0.
    centre, minor, major, angle = (
        jnp.where(seen.visible, value, instead)
        for value, instead in (
            (jnp.moveaxis(seen.centre, -1, 0), 0.0),
            (seen.semi_axes[..., 0], 1.0),
            (seen.semi_axes[..., 1], 1.0),
            (seen.angle, 0.0),
        )
    )
    sigma = jnp.broadcast_to(_SIGMA_PX, (*minor.shape, 5))
    # Noise turns an outline that is nearly round by much.
    sigma = sigma.at[..., 4].divide(jnp.maximum(major - minor, _SIGMA_PX))
    off = sigma * noise
    ellipses = optics.Ellipse(
        jnp.moveaxis(centre, 0, -1) + off[..., :2],
        major + off[..., 2],
        minor + off[..., 3],
        angle + off[..., 4],
    )
    covariances = sigma[..., None] ** 2 * jnp.eye(5)
    nothing = jnp.zeros(count)
    whitening = jax.vmap(whitening_of)(ellipses, covariances, nothing)
    every = Group(
        ellipses=ellipses,
        whitening=jnp.where(seen.visible[..., None, None], whitening, 0.0),
        readings=jnp.broadcast_to(distance - distance[0], minor.shape),
        motions=seen.axis[:, 0],
        axes=seen.axis[:, 0],
        principal_points=jnp.zeros((count, 2)),
        touch_means=jnp.full(count, distance[0]),
        touch_sigmas=jnp.full(count, _TOUCH_MM),
        lean_sigma=nothing,
        boresight_sigma=nothing,
        size_sigmas=SIZE_PER_MM * jnp.array(WITHDRAWALS_C_MM),
        kind="eyeball",
        data=5 * minor.size,
        numbers=tuple(range(count)),
    )

    def pinhole(unknown: Float[Array, "3"]) -> Pinhole:
        scale = SCALE_MM_PX * jnp.exp(unknown[0])
        return Pinhole(scale, unknown[1], RETINA.mean + RETINA.sigma * unknown[2])

    def residuals(eye: Float[Array, "3"], own: Float[Array, "4"], trial: Group) -> Array:
        found = pinhole(eye)
        values = _NO_TILT | {
            "half_angle": CONE["half_angle"],
            "b": CONE["apex_offset"],
            "eye_radius": found.radius,
        }
        # The robot's axis is known, so only these nuisances are free.
        nuisances = jnp.zeros(len(NUISANCES)).at[_FREE].set(own)
        alone = jax.tree.map(lambda leaf: leaf[None], trial)
        missed = misfit(alone, found.microscope, values, nuisances[None])
        # Without a visible frame the place would have no value. Every trial carries its part of the
        # retina's prior.
        held = own[1:3] / _ANYWHERE_PX, eye[2:] / math.sqrt(count)
        return jnp.concatenate([missed, *held])

    start = jnp.zeros(3), jnp.zeros((count, len(_FREE)))
    # The problem is nearly linear. 1e-6 of kappa or of a touch moves no distance by 1e-5 mm.
    eye, _, _ = gauss_newton_in_blocks(residuals, *start, every, tolerance=1e-6)
    return pinhole(eye)


_ANYWHERE_PX = 1e4
_FREE = np.array([NUISANCES.index(name) for name in ("touch", "u", "v", "size")])
_NO_TILT = {"tilt_x": 0.0, "tilt_y": 0.0}


def distance_by_area(seen: Seen, pinhole: Pinhole) -> Float[np.ndarray, "n"]:
    """Distances at which exact spots have the measured centres and areas, mm.

    Each spot is seen by its own pinhole over its own sphere; the robot knows the beams' axes.
    """
    return in_batches(_through_pinholes, (seen, pinhole), size=_SPOTS_AT_ONCE)


def distance_through_path(
    seen: Seen, camera: PathCamera, semi_axes: Float[ArrayLike, "3"]
) -> Float[np.ndarray, "n"]:
    """As `distance_by_area`, with all spots seen through one path onto one retina, mm."""
    retina = optics.Ellipsoid(jnp.asarray(semi_axes))
    return in_batches(lambda spots: _through_path(spots, camera, retina), seen, size=_SPOTS_AT_ONCE)


@eqx.filter_jit
def _through_pinholes(spots: tuple[Seen, Pinhole]) -> Float[Array, "n"]:
    def one(seen: Seen, pinhole: Pinhole) -> Float[Array, ""]:
        return _by_area(seen, pinhole.wall, pinhole.microscope)

    return jax.vmap(one)(*spots)


@eqx.filter_jit
def _through_path(seen: Seen, camera: PathCamera, retina: optics.Surface) -> Float[Array, "n"]:
    return jax.vmap(lambda spot: _by_area(spot, retina, camera))(seen)


def _by_area(seen: Seen, wall: optics.Surface, camera: optics.Camera) -> Float[Array, ""]:
    minor, major = seen.semi_axes
    ellipse = optics.Ellipse(seen.centre, major, minor, jnp.zeros(()))
    return optics.distance_by_area(ellipse, wall, camera, axis=seen.axis, **CONE)


def distance_by_closed_form(
    model: str,
    semi_minor: np.ndarray,
    spots: Spots,
    *,
    pinhole: Pinhole,
) -> np.ndarray:
    """Distance by one of `optics.CLOSED_FORMS` for one pinhole, or for one an eye, mm."""
    return np.asarray(
        optics.closed_form_distance(
            model,
            semi_minor_px=semi_minor,
            scale=pinhole.scale,
            k=1.0 / np.tan(CONE["half_angle"]),
            b=CONE["apex_offset"],
            eccentricity=np.asarray(spots.eccentricity),
            eye_radius=pinhole.radius,
            inverse_working_distance=pinhole.kappa,
        )
    )


def distance_by_local_magnification(semi_minor: np.ndarray, factor: np.ndarray) -> np.ndarray:
    """Distance with e1 = delta e1' times a factor that depends on c, mm (`local_factor`)."""
    return np.asarray(
        optics.sphere_distance(
            spot_radius=SCALE_MM_PX * semi_minor * factor,
            k=1.0 / np.tan(CONE["half_angle"]),
            b=CONE["apex_offset"],
            eye_radius=NOMINAL_RADIUS_MM,
        )
    )


def local_factor(camera: PathCamera, eccentricity: np.ndarray) -> np.ndarray:
    """1/min(h/c, dh/ds): mm on the wall per mm of a small spot's semi-minor image, by c."""
    wall = optics.Sphere(NOMINAL_RADIUS_MM)
    return 1.0 / np.asarray(local_magnification(camera, wall, eccentricity=eccentricity))[..., 1]
