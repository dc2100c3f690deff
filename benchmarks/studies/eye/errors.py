"""Errors of every recipe in many eyes behind one viewing path."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

import optics
from benchmarks.studies.eye.geometry import (
    NOMINAL_RADIUS_MM,
    SCALE_MM_PX,
    Pinhole,
    Seen,
    Spots,
    cameras,
    in_batches,
    spots_through,
)
from benchmarks.studies.eye.recipes import (
    Recipe,
    distance_by_area,
    distance_by_closed_form,
    distance_by_local_magnification,
    distance_through_path,
    fitted_pinhole,
    local_factor,
    withdrawals,
)
from optics.viewing import DILATED_MM, Eye, PathCamera

_OPEN_MM = 50.0  # radius of a pupil that hides nothing
_EYES_AT_ONCE = 8  # few enough that their spots stay in the cache


class PathErrors(NamedTuple):
    """Errors behind one path; NaN where the optics show no whole contour.

    Attributes:
        errors: of each recipe, eyes x c x d x tilts, mm; as if the iris hid nothing.
        kappas: fitted in each eye, 1/mm; the first is the schematic eye's.
        paraxial_kappa: of the schematic eye's path, 1/mm.
    """

    errors: dict[Recipe, np.ndarray]
    kappas: np.ndarray
    paraxial_kappa: float


def path_errors(
    path: str,
    eyes: Sequence[Eye],
    spots: Spots,
    *,
    seed: int | None,
    recipes: Sequence[Recipe] = tuple(Recipe),
) -> PathErrors:
    """Look at spots in every eye, calibrate each, and compute distances by every recipe.

    Args:
        path: name of the viewing path.
        eyes: groups of eyes, each with a leading axis; all groups are joined. The first eye is the
            schematic one, which stands for all others where no calibration is made; it is
            calibrated without noise.
        spots: c x d x tilts.
        seed: of the noise of the calibrations; None for none.
    """
    axes = jnp.concatenate([group.retina_semi_axes for group in eyes])
    every = _cameras(path, eyes, pupil_radius=_OPEN_MM)
    batches = every, axes, _noise(seed, len(axes))
    seen, fitted = in_batches(lambda eyes: _calibrated(eyes, spots), batches, size=_EYES_AT_ONCE)
    schematic = jax.tree.map(lambda leaf: leaf[0], fitted)
    known = jax.tree.map(lambda leaf: leaf[0], every)
    shape, minor = seen.visible.shape, seen.semi_axes[..., 0]
    in_a_row = jax.tree.map(lambda leaf: leaf.reshape(-1, *leaf.shape[len(shape) :]), seen)
    own = jax.tree.map(lambda leaf: leaf[:, None, None, None], fitted)
    paraxial = float(known.inverse_working_distance)
    uncalibrated = Pinhole(*map(jnp.asarray, (SCALE_MM_PX, 0.0, NOMINAL_RADIUS_MM)))

    def closed_form(model: str, pinhole: Pinhole) -> np.ndarray:
        return distance_by_closed_form(
            model, minor, spots, pinhole=jax.tree.map(np.asarray, pinhole)
        )

    def by_area(pinhole: Pinhole) -> np.ndarray:
        each = jax.tree.map(lambda leaf: np.broadcast_to(leaf, shape).ravel(), pinhole)
        return distance_by_area(in_a_row, each)

    def by_magnification() -> np.ndarray:
        factor = local_factor(known, np.asarray(spots.eccentricity).ravel())
        return distance_by_local_magnification(minor, factor.reshape(spots.distance.shape))

    ways: dict[Recipe, Callable[[], np.ndarray]] = {
        Recipe.PLANAR: lambda: closed_form("planar", uncalibrated),
        Recipe.SMALL_PLANE: lambda: closed_form("small_plane", uncalibrated),
        Recipe.STEREOGRAPHIC: lambda: closed_form("stereographic", uncalibrated),
        Recipe.PARAXIAL: lambda: closed_form(
            "corrected", uncalibrated._replace(kappa=jnp.asarray(paraxial))
        ),
        Recipe.LOCAL: by_magnification,
        Recipe.FITTED: lambda: closed_form("corrected", own),
        Recipe.EXACT_SCHEMATIC: lambda: distance_through_path(in_a_row, known, axes[0]),
        Recipe.AREA_SCHEMATIC: lambda: by_area(schematic),
        Recipe.AREA: lambda: by_area(own),
    }
    truth = np.asarray(spots.distance)

    def error(recipe: Recipe) -> np.ndarray:
        read = ways[recipe]().reshape(shape)
        return np.where(seen.visible, read - truth, np.nan)

    return PathErrors(
        errors={recipe: error(recipe) for recipe in recipes},
        kappas=fitted.kappa,
        paraxial_kappa=paraxial,
    )


def fields(path: str, eyes: Sequence[Eye]) -> np.ndarray:
    """Largest c that each eye's dilated pupil shows, mm; arguments as for `path_errors`."""
    axes = jnp.concatenate([group.retina_semi_axes for group in eyes])
    every = _cameras(path, eyes, pupil_radius=DILATED_MM)
    return in_batches(_fields, (every, axes), size=_EYES_AT_ONCE)


@eqx.filter_jit
def _calibrated(
    eyes: tuple[PathCamera, Float[Array, "n 3"], Float[Array, "n trials frames 5"]], spots: Spots
) -> tuple[Seen, Pinhole]:
    """Images of the spots in every eye, n x c x d x tilts, and the pinhole fitted there."""
    flat, calibration = jax.tree.map(jnp.ravel, spots), withdrawals()
    count, shape = len(flat.distance), calibration.distance.shape
    # All spots in one batch: XLA compiles the formula once.
    together = jax.tree.map(lambda a, b: jnp.concatenate([a, jnp.ravel(b)]), flat, calibration)

    def in_one(camera: PathCamera, semi_axes: Array, noise: Array) -> tuple[Seen, Pinhole]:
        images = spots_through(camera, semi_axes, together)
        last = jax.tree.map(lambda leaf: leaf[count:].reshape(shape + leaf.shape[1:]), images)
        first = jax.tree.map(
            lambda leaf: leaf[:count].reshape(spots.distance.shape + leaf.shape[1:]), images
        )
        return first, fitted_pinhole(last, noise)

    return jax.vmap(in_one)(*eyes)


def _cameras(path: str, eyes: Sequence[Eye], *, pupil_radius: float) -> PathCamera:
    def of_batch(eyes: Eye) -> PathCamera:
        return cameras(path, eyes, jnp.asarray(pupil_radius))

    groups = [in_batches(of_batch, group, size=_EYES_AT_ONCE) for group in eyes]
    return jax.tree.map(lambda *leaves: np.concatenate(leaves), *groups)


@eqx.filter_jit
def _fields(eyes: tuple[PathCamera, Float[Array, "n 3"]]) -> Float[Array, "n"]:
    return jax.vmap(lambda camera, axes: camera.field(optics.Ellipsoid(axes)))(*eyes)


def _noise(seed: int | None, count: int) -> Float[np.ndarray, "n trials frames 5"]:
    """Noise of each eye's withdrawals; 0 without a seed, and for the schematic eye."""
    shape = (*withdrawals().distance.shape, 5)
    if seed is None:
        return np.zeros((count, *shape))
    drawn = [np.random.default_rng([seed, eye]).standard_normal(shape) for eye in range(count)]
    return np.stack([np.zeros(shape), *drawn[1:]])


def together(*groups: Eye) -> Eye:
    """Groups of eyes of one structure as one group."""
    return jax.tree.map(lambda *leaves: jnp.concatenate(leaves), *groups)
