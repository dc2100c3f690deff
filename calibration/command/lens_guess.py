"""Lenses from which a fit to pixels starts: those whose spots look like the recorded ones."""

import math
from collections.abc import Iterable, Iterator, Mapping
from operator import itemgetter
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from scipy.optimize import least_squares

from eyespot import optics
from eyespot.calibration.pixels.data import Footage
from eyespot.calibration.recorded_trial import FREE_TOUCH, RecordedTrial
from eyespot.calibration.spots.cone_trials import Prior
from eyespot.formats.inputs import InputError
from eyespot.optics.wall_light.lens_flux import lens_of

_SAGS = (0.02, 0.08, 0.25, 0.5)
"""Heights of the cap over the core's radius: nearly flat to a round drop."""
_APERTURES = (0.05, 0.08, 0.12, 0.18, 0.27, 0.4)
"""Numerical apertures. Neighbours differ by half, so one is within 23 % of any other."""
_TOUCHES = (0.1, 0.4, 1.0, 2.0, 4.0)
"""Distances in the first frame, mm, where none is stated."""
_REFINEMENTS = 6  # steps of a guess
_STARTS = 3  # lenses to start from
_COMPARED_SPOTS = 6  # that are compared
_NEAREST_MM = 0.05  # distance of a spot that is compared
_RINGS = np.linspace(0.05, 2.0, 32)
"""Radii of the rings over the spot's own, whole batches of quadrature. Behind a high drop the light
falls from the middle on and has no edge, so all of it is compared."""
_RING_ERROR = 0.03
"""Expected error of a ring's light over the spot's: by the wall's texture and its slope."""
_ALIKE, _FOREIGN = 1.0, 9.0
"""Mean square error of a spot's rings, median over the spots, in the unit above: below the first a
lens is taken at once, and beyond the second it is no lens of these spots. Of five true lenses (14,
15, 28, 30 and 32 of `random_fits` in v0.2.1) it was 0.03 to 0.9, of wrong minima 2 to
9, and of the best lenses for two cones 25 and 32."""


def guessed_lenses(
    recording: RecordedTrial,
    footage: Footage,
    kind: Mapping[str, float],
    priors: Mapping[str, Prior],
) -> Iterator[dict[str, float]]:
    """Lenses whose spots resemble the recorded ones: the best of a coarse grid, by least squares.

    Compares the light of rings around some spots with that on perpendicular planes, at the
    distances given by the readings and the touch. Each spot's brightness and background are free,
    and the touch where nobody states it.

    Args:
        recording: the measured spots.
        footage: the images.
        kind: `optics.wall_light.lens_flux.PARAMETERS` of a lens of the same fibre, compared too.
        priors: of the drop, where it is not known.

    Yields:
        The parameters of one lens after the other, and the touch, mm; those that resemble the spots
        come first.

    Raises:
        InputError: no lens resembles the spots, although nothing is known of it.
    """
    trial = recording.trial
    distances = np.maximum(trial.readings + trial.touch.mean, _NEAREST_MM)
    evenly = np.geomspace(distances.min(), distances.max(), _COMPARED_SPOTS)
    spots = np.unique(np.abs(distances - evenly[:, None]).argmin(axis=1))
    seen = np.array([_rings(recording, footage, spot) for spot in spots])
    known = np.isfinite(seen)
    radius = _RINGS * _radii_on_wall(recording)[spots, None]
    free = trial.touch == FREE_TOUCH
    touches = _TOUCHES if free else (trial.touch.mean,)
    size = np.nanmax(seen, axis=1) - np.nanmin(seen, axis=1)

    def without_mean(light: Float[np.ndarray, "s r"]) -> Float[np.ndarray, "s r"]:
        return np.where(known, light - light.mean(axis=1, keepdims=True, where=known), 0.0)

    def mismatch(lens: Mapping[str, float]) -> Float[np.ndarray, "s r"]:
        field = optics.LensField(lens_of(lens), optics.MEDIA[recording.medium])
        distance = np.maximum(trial.readings[spots, None] + lens["touch"], _NEAREST_MM)
        distance = np.broadcast_to(distance, radius.shape)
        light = field(radius=jnp.asarray(radius), distance=jnp.asarray(distance))[1]
        alone, own = without_mean(np.asarray(light)), without_mean(seen)
        square = np.maximum(np.sum(alone**2, axis=1), np.finfo(float).tiny)
        brightness = np.sum(alone * own, axis=1) / square
        return (own - brightness[:, None] * alone) / size[:, None] / _RING_ERROR

    def misfit(lens: Mapping[str, float]) -> float:
        # The median tolerates outliers; no spot agrees exactly with a coarse grid.
        return float(np.median(np.square(mismatch(lens)).mean(axis=1)))

    names = dict.fromkeys(("sag", "numerical_aperture", *priors, *(["touch"] if free else ())))

    def refined(lens: dict[str, float]) -> dict[str, float]:
        """Least squares from a lens of the grid; its steps are ratios, since all are positive."""

        def changed(ratios: Float[np.ndarray, "p"]) -> dict[str, float]:
            drop = lens | {n: lens[n] * math.exp(r) for n, r in zip(names, ratios, strict=True)}
            drop["aperture_radius"] = max(drop["aperture_radius"], drop["core_radius"])
            drop["sag"] = min(drop["sag"], drop["aperture_radius"])
            return drop

        def residuals(ratios: Float[np.ndarray, "p"]) -> Float[np.ndarray, "n"]:
            drop = changed(ratios)
            off = [(drop[name] - prior.mean) / prior.sigma for name, prior in priors.items()]
            # The errors of a spot's rings are alike: they count as one.
            return np.concatenate([mismatch(drop).ravel() / math.sqrt(_RINGS.size), off])

        start = np.zeros(len(names))
        within = (start - 2.0, start + 2.0)
        steps: Any = {"loss": "soft_l1", "diff_step": 0.02, "max_nfev": _REFINEMENTS}
        return changed(least_squares(residuals, start, bounds=within, x_scale=0.1, **steps).x)

    def best(lenses: Iterable[dict[str, float]]) -> tuple[float, dict[str, float]]:
        every = ({**lens, "touch": touch} for lens in lenses for touch in touches)
        return min(((misfit(lens), lens) for lens in every), key=itemgetter(0))

    ranked = [best([dict(kind)])]
    for share in _SAGS:
        cap = {**kind, "sag": share * kind["core_radius"]}
        ranked.append(best({**cap, "numerical_aperture": aperture} for aperture in _APERTURES))
    others = []
    for _, lens in sorted(ranked, key=itemgetter(0))[:_STARTS]:
        drop = refined(lens)
        off = misfit(drop)
        if off < _ALIKE:
            yield drop
        else:
            others.append((off, drop))
    others.sort(key=itemgetter(0))
    if priors and len(others) == _STARTS and others[0][0] > _FOREIGN:
        raise InputError(
            "the spots are those of no glue lens: the most similar one misses "
            f"{_RING_ERROR * math.sqrt(others[0][0]):.0%} of their light (RMS, median).\n"
            "Try --model cone if their edges are sharp, or --lens FILE, which begins with your "
            "lens whatever the spots say."
        )
    yield from (drop for _, drop in others)


def _rings(recording: RecordedTrial, footage: Footage, spot: int) -> Float[np.ndarray, "r"]:
    """Median light of elliptical rings around a spot, full wells; NaN where no pixel shows it."""
    at = recording.records[spot].frame
    image, clear = footage.light[at], footage.clear[at]
    (u, v), major, minor, angle = (np.asarray(x)[spot] for x in recording.trial.ellipses)
    down, right = np.indices(image.shape)
    turn = np.exp(-1j * angle) * (right - u + 1j * (down - v))
    width = _RINGS[1] - _RINGS[0]
    ring = np.rint((np.hypot(turn.real / major, turn.imag / minor) - _RINGS[0]) / width)
    inside = [image[(ring == k) & clear] for k in range(_RINGS.size)]
    return np.array([np.median(light) if light.size else math.nan for light in inside])


def _radii_on_wall(recording: RecordedTrial) -> Float[np.ndarray, "n"]:
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
