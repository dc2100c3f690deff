"""Recipes: what a person calibrates at the table, and how a distance is then computed."""

from __future__ import annotations

from enum import StrEnum
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Float, PRNGKeyArray

import optics
from benchmarks.studies.eye.geometry import (
    CONE,
    NOMINAL_RADIUS_MM,
    SCALE_MM_PX,
    Seen,
    Spots,
    grid,
    pinhole_microscope,
    through_pinhole,
)
from optics.viewing import PathCamera, local_magnification

_SIGMA_PX = 0.1
"""Standard deviation of a measured semi-axis; the sub-pixel mode's RMS on textured walls is 0.05 to
0.1 px (`eyespot validate`)."""
_TOUCH_MM = 0.05
"""Standard deviation of the distance at which a withdrawal starts: the operator's touch."""

WITHDRAWALS_C_MM = (0.5, 1.5, 3.0)
_WITHDRAWALS = grid(np.array(WITHDRAWALS_C_MM), np.linspace(1.0, 5.0, 9), ((25.0, 90.0),))
"""Three withdrawals through a trocar, nine frames each."""


class Recipe(StrEnum):
    """Ways to a distance, from what has to be known least to most."""

    SMALL_PLANE = "small_plane"
    """The paper's closed form; nothing is known of the eye."""

    PARAXIAL = "corrected, paraxial pinhole"
    """`corrected` with the paraxial pinhole of the schematic eye's path."""

    LOCAL = "corrected, schematic eye"
    """`corrected` with the schematic eye's own local magnification."""

    FITTED = "corrected, fitted pinhole"
    """`corrected` with a pinhole fitted in this eye."""

    AREA_SCHEMATIC = "area, schematic pinhole"
    """Exact geometry and the ellipse's area, with the pinhole fitted in the schematic eye."""

    AREA = "area, fitted pinhole"
    """Exact geometry and the ellipse's area, with a pinhole fitted in this eye."""


class Pinhole(NamedTuple):
    """A pinhole that stands for a path.

    Attributes:
        scale: delta, mm/px at the pole.
        kappa: 1/(z_F + r), 1/mm; negative behind the retina.
    """

    scale: Float[Array, "*batch"]
    kappa: Float[Array, "*batch"]


def withdrawals() -> Spots:
    """The spots of the calibration."""
    return _WITHDRAWALS


@eqx.filter_jit
def fitted_pinhole(seen: Seen, key: PRNGKeyArray, noise: Float[Array, ""]) -> Pinhole:
    """Fit delta and kappa to the semi-axes of three withdrawals in one eye.

    The robot's axis and its relative motion are known; where each withdrawal starts is known to
    0.05 mm, so its offset is fitted with this prior. Frames whose contour is hidden do not count.

    Args:
        seen: images of `withdrawals()`.
        key: random key of the measurement's noise.
        noise: its amount; 1 is what the sub-pixel mode has, 0 none.
    """
    spots = _WITHDRAWALS
    errors = _SIGMA_PX * jax.random.normal(key, seen.semi_axes.shape)
    measured = seen.semi_axes + noise * errors
    of = jnp.broadcast_to(jnp.arange(len(WITHDRAWALS_C_MM))[:, None, None], spots.distance.shape)
    weight = jnp.where(seen.visible, 1.0 / _SIGMA_PX, 0.0)[..., None]

    def residuals(unknown: Float[Array, "n"], _: None) -> Float[Array, "m"]:
        scale, kappa, offsets = SCALE_MM_PX * jnp.exp(unknown[0]), unknown[1], unknown[2:]
        moved = spots._replace(distance=spots.distance + offsets[of])
        flat = jax.tree.map(jnp.ravel, moved)
        expected = jax.vmap(lambda s: through_pinhole(kappa, scale, s).semi_axes)(flat)
        image = weight * (expected.reshape(measured.shape) - measured)
        return jnp.concatenate([jnp.ravel(image), offsets / _TOUCH_MM])

    start = jnp.zeros(2 + len(WITHDRAWALS_C_MM))
    # The problem is nearly linear. 1e-6 of kappa or of an offset moves no distance by 1e-5 mm.
    solver: optx.AbstractLeastSquaresSolver = optx.GaussNewton(rtol=1e-6, atol=1e-6)
    best = optx.least_squares(residuals, solver, start, max_steps=10, throw=False).value
    return Pinhole(SCALE_MM_PX * jnp.exp(best[0]), best[1])


@eqx.filter_jit
def distance_by_area(seen: Seen, pinhole: Pinhole) -> Float[Array, "n"]:
    """Distances at which exact spots on the nominal sphere have the measured centres and areas, mm.

    Each spot is seen by its own pinhole; the robot knows the beams' axes.

    Args:
        seen: images of n spots.
        pinhole: n pinholes.
    """

    def one(seen: Seen, pinhole: Pinhole) -> Float[Array, ""]:
        minor, major = seen.semi_axes
        return optics.distance_by_area(
            optics.Ellipse(seen.centre, major, minor, jnp.zeros(())),
            optics.Sphere(NOMINAL_RADIUS_MM),
            pinhole_microscope(pinhole.kappa, pinhole.scale),
            axis=seen.axis,
            **CONE,
        )

    return jax.lax.map(lambda given: one(*given), (seen, pinhole), batch_size=1024)


def distance_by_closed_form(
    model: str,
    semi_minor: np.ndarray,
    spots: Spots,
    *,
    scale: float | np.ndarray,
    kappa: float | np.ndarray,
) -> np.ndarray:
    """Distance by `small_plane` or `corrected` on the nominal sphere, mm."""
    return np.asarray(
        optics.closed_form_distance(
            model,
            semi_minor_px=semi_minor,
            scale=scale,
            k=1.0 / np.tan(CONE["half_angle"]),
            b=CONE["apex_offset"],
            eccentricity=np.asarray(spots.eccentricity),
            eye_radius=NOMINAL_RADIUS_MM,
            inverse_working_distance=kappa,
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
