"""A start lens for the fit to pixels, chosen by the sizes and edge widths of the spots."""

from __future__ import annotations

import itertools

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

import optics
from calibration.recordings import Recording

FLATTEST = 0.02
"""Height of the flattest start cap over the core's radius; a sag of 0 cannot be fitted."""
_SAGS = (FLATTEST, 0.08, 0.25, 0.5)
"""Heights of the cap over the core's radius: nearly flat to a round drop."""
_APERTURES = (0.05, 0.075, 0.1, 0.15, 0.2, 0.3, 0.4)
"""Numerical apertures. Neighbours differ by a third, so one is within the 30 % that a start may
deviate."""
_GLUE_INDEX = 1.49
"""Refractive index of cyanoacrylate: 1.48 to 1.50 in data sheets."""
_DISTANCES, _RADII = 24, 257
_SIZE_ERROR, _EDGE_ERROR = 0.05, 0.1
"""Weights: expected errors of a guess's radius (relative) and of its relative edge width."""


def guessed_lens(recording: Recording) -> optics.GlueLens:
    """The lens on a coarse grid whose spots are most similar to the measured ones.

    Compares the half-maximum radius and the edge width on perpendicular planes with the semi-minor
    axis and the edge width of the spots, at the distances given by the readings and the touch.

    Args:
        recording: the measured spots; the core is assumed to be as wide as the fibre.
    """
    trial = recording.trial
    distance = np.maximum(trial.readings + trial.touch.mean, 0.05)
    sampled = np.geomspace(distance.min(), distance.max(), _DISTANCES)
    measured = _radii_on_wall(recording)
    best: tuple[float, optics.GlueLens] | None = None
    for sag, aperture in itertools.product(_SAGS, _APERTURES):
        lens = _drop(recording.fibre_radius_mm, sag * recording.fibre_radius_mm, aperture)
        field = optics.LensField(lens, optics.MEDIA[recording.medium])
        radius, width = (np.interp(distance, sampled, y) for y in _spots(field, sampled))
        misfit = (np.log(radius / measured) / _SIZE_ERROR) ** 2
        misfit += ((width - recording.relative_edge_width) / _EDGE_ERROR) ** 2
        # The median tolerates outliers; no spot agrees exactly with a coarse grid.
        if best is None or float(np.median(misfit)) < best[0]:
            best = float(np.median(misfit)), lens
    assert best is not None
    return best[1]


def _drop(core_radius: float, sag: float, numerical_aperture: float) -> optics.GlueLens:
    """A drop of glue on the core's face, as wide as the core."""
    return optics.glue_lens(
        core_radius=core_radius,
        aperture_radius=core_radius,
        glue_length=sag,
        sag=sag,
        glue_index=_GLUE_INDEX,
        numerical_aperture=numerical_aperture,
    )


def _spots(
    field: optics.LensField, distances: Float[np.ndarray, "n"]
) -> tuple[Float[np.ndarray, "n"], Float[np.ndarray, "n"]]:
    """Half-maximum radius, mm, and relative edge width (see `Spot.edge_width_px`), at distances."""
    rows = jnp.asarray(distances)[:, None]
    radius = field.envelope(rows) * np.linspace(0.0, 1.0, _RADII)
    light = np.asarray(field(radius=radius, distance=jnp.broadcast_to(rows, radius.shape))[1])
    half = 0.5 * light.max(axis=1)
    lit = light >= half[:, None]
    last = np.minimum(_RADII - 1 - np.argmax(lit[:, ::-1], axis=1), _RADII - 2)
    at = np.arange(len(distances))
    inner, outer = light[at, last], light[at, last + 1]
    step = np.asarray(radius)[:, 1]
    edge = (last + (inner - half) / (inner - outer)) * step
    # A Gaussian-blurred step of height 2 half has the slope 2 half/(sqrt(2 pi) width).
    width = 2.0 * half * step / (np.sqrt(2.0 * np.pi) * (inner - outer))
    return edge, width / edge


def _radii_on_wall(recording: Recording) -> Float[np.ndarray, "n"]:
    """Semi-minor axes on the wall, mm."""
    microscope, trial = recording.microscope, recording.trial
    size = np.asarray(trial.ellipses.semi_minor) * microscope.scale_mm_px
    if trial.kind == "plane":
        return size
    right, down = (np.asarray(trial.ellipses.centre) - trial.principal_point).T
    eye = {
        "eye_radius": microscope.eye_radius_mm,
        "inverse_working_distance": microscope.inverse_working_distance,
    }
    x, y, _ = optics.eyeball_point(
        right_px=right, down_px=down, scale=microscope.scale_mm_px, **eye
    )
    return size * np.asarray(optics.corrected_factor(eccentricity=np.hypot(x, y), **eye))
