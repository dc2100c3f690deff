"""Models image and lens of `eyespot fit`, fitted to every pixel of one stack.

The fit of a lens starts from one that is chosen by the sizes and edge widths of the spots.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float
from scipy import ndimage

import optics
from calibration.command.choices import Choices
from calibration.command.cone_models import cone_start
from calibration.command.fitted import Fitted, PixelResiduals, bounds_hit
from calibration.pixels import FREE, LENS, UNITS, ImageFit, fit_footage, lens_start, read_footage
from calibration.recordings import Recording
from calibration.spots import Prior
from estimator import read_stack
from estimator.files import BEAM, LENS_PARAMETERS
from estimator.run import progress, say
from optics import InputError
from optics.wall_light import TABLE_ERROR

_SAGS = (0.02, 0.08, 0.25, 0.5)
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


_BLUR_PX = 1.0  # start value: a camera in focus
_SPREAD_MM = 0.03  # start value: about that of paper
_CONE_IN_FILE = ("half_angle", "b")
_EITHER_IN_FILE = ("scale", "eye_radius")
_BEAM = ("boresight", "boresight_sideways")
_SECONDS = {"cone": (10.0, 3e-6), "lens": (60.0, 5e-7)}
"""Time of a fit on two cores, and its increase per pixel and frame, to a factor of two."""
_STATED = 1.05
"""Factor above which the report says that numerical errors enlarge the standard errors."""
_MAPS, _SMOOTHING = 6, 0.03
"""Number of the maps of residuals, and the sigma of their smoothing over the lit part's size."""
_WIDTHS = ("core_radius", "aperture_radius")
_CORE, _CAP = (0.9, 0.15), (1.06, 0.12)
"""Radii of a fibre's core and of a drop's rim over the fibre's radius, and their standard
deviations: cladding and jacket take up to a quarter of it, and glue may run over the edge."""
_HOLLOW_MM = 1e-4
"""Depth of a hollow end that counts as flat: a fifth of a wavelength, which no light shows."""
_BRIGHTNESS = ("sensitivity", "power", "reflectance")
"""Factors of a calibration file's brightness; it is their product over pi."""


def fit_image_of_cone(recordings: Sequence[Recording], choices: Choices) -> Fitted:
    """Fit half-angle and b of a cone to pixels; start with the paper's line through the spots."""
    (recording,) = recordings
    start = cone_start(recordings)
    if "blur" in choices.names:
        start["blur"] = _BLUR_PX
    return _fitted(recording, choices, "cone", start)


def fit_image_of_lens(recordings: Sequence[Recording], choices: Choices) -> Fitted:
    """Fit shape, aperture and brightness of a glue lens to pixels.

    Starts from the lens that was chosen, or else from one guessed from the spots. If that lens
    misses light, its core and its cap may be narrower or wider than the fibre, so they are free.
    """
    (recording,) = recordings
    if choices.lens:
        return _fitted(recording, choices, "lens", lens_start(optics.load_lens(choices.lens)))
    start = lens_start(guessed_lens(recording))
    say(
        f"Starting from a lens with sag {start['sag']:.3g} mm and numerical aperture "
        f"{start['numerical_aperture']:.3g}, guessed from the spots.",
    )
    return _fitted(recording, choices, "lens", start, widths=not choices.names)


def _fitted(
    recording: Recording,
    choices: Choices,
    source: Literal["cone", "lens"],
    start: dict[str, float],
    *,
    widths: bool = False,
) -> Fitted:
    """Fit, and bring the result into the form that all models share.

    Args:
        recording: the stack with its measured spots.
        choices: what was asked for.
        source: kind of the light source.
        start: start values.
        widths: whether the radii of core and cap may be fitted too, if the light asks for it.
    """
    if "spread" in choices.names:
        start["spread"] = _SPREAD_MM
    if any(recording.tilt):
        raise InputError(
            f"{recording.name} shows a tilted plane. The fit to pixels supports only planes "
            "perpendicular to the microscope's axis. Use --model cone, which supports a tilt."
        )
    footage = read_footage(read_stack(recording.source), exposure=choices.exposure)
    least, per_pixel = _SECONDS[source]
    minutes = (least + footage.light.size * per_pixel) / 60
    rounded = f"about {minutes:.0f}" if minutes >= 1 else "less than 1"
    say(
        f"Fitting a {source} to {len(footage.readings)} frames: {rounded} min on two cores.",
    )
    with progress("Fitting", total=None) as advance:
        told: dict[str, Any] = {
            "source": source,
            "progress": lambda chi_squared: advance(note=f"chi squared {chi_squared:.4g}"),
        }
        fit = fit_footage(
            footage, start=start, free=choices.names or None, priors=choices.priors, **told
        )
        radii = {
            name: Prior(share * recording.fibre_radius_mm, sigma * recording.fibre_radius_mm)
            for name, (share, sigma) in zip(_WIDTHS, (_CORE, _CAP), strict=True)
        }
        if widths and (fit.failed or fit.misfit.share > TABLE_ERROR):
            wider = fit_footage(
                footage,
                start={name: fit.values[name] for name in LENS}
                | {name: prior.mean for name, prior in radii.items()},
                free=(*_WIDTHS, *FREE["lens"]),
                priors=radii | choices.priors,
                **told,
            )
            if not wider.failed and wider.misfit.share < fit.misfit.share:
                fit = wider

    def in_file(fitted: Mapping[str, ArrayLike]) -> dict[str, Array]:
        """The calibration's parameters; with the beam's direction, if it is determined."""
        every = {**fit.values, **fitted}
        names = [name for name in _EITHER_IN_FILE if name in fitted]
        if source == "cone":
            found = {name: every[name] for name in (*_CONE_IN_FILE, *names)}
        else:
            found = {
                **{name: every[name] for name in LENS_PARAMETERS if name in LENS},
                "glue_length": every["rim_height"] + every["sag"],
                **{name: every[name] for name in names},
                # As a part of full scale, of which the black level takes a share.
                "brightness": (1 - footage.noise.black)
                * math.prod(every[name] for name in _BRIGHTNESS)
                / math.pi,
            }
        if all(math.isfinite(fit.parameters[name][1]) for name in _BEAM):
            beam = recording.beam_slopes @ jnp.array([every[name] for name in _BEAM])
            found |= dict(zip(BEAM, beam, strict=True))
        return {name: jnp.asarray(value, float) for name, value in found.items()}

    fitted = {name: value for name, (value, _) in fit.parameters.items()}
    values = {name: float(value) for name, value in in_file(fitted).items()}
    if -_HOLLOW_MM < values.get("sag", 0.0) < 0.0:
        values["glue_length"] = max(values["glue_length"] - values["sag"], 0.0)
        values["sag"] = 0.0
    slopes = jax.jacfwd(in_file)(fitted)
    follows = np.array([[slopes[name][own] for own in fitted] for name in values])
    numbers, of_frames = _of_frames(fit)
    maps, groups = _maps(fit)
    return Fitted(
        calibration_model="exact" if source == "cone" else "lens",
        values=values,
        covariance=_propagated(follows, fit.covariance),
        converged=fit.converged,
        failed=fit.failed,
        bounds=bounds_hit(values),
        undetermined=fit.undetermined,
        chi_squared=fit.chi_squared,
        degrees_of_freedom=fit.degrees_of_freedom,
        residuals={},
        recordings=[recording],
        used=len(numbers),
        others=[
            (name, value, error, UNITS[name])
            for name, (value, error) in fit.parameters.items()
            if name not in (*_CONE_IN_FILE, *LENS, *_EITHER_IN_FILE)
        ],
        notes=_notes(fit),
        pixels=PixelResiduals(maps, groups, numbers, of_frames, fit.misfit),
    )


def _notes(fit: ImageFit) -> list[str]:
    """What was fitted, and what enlarged the standard errors."""
    cells = np.count_nonzero(np.isfinite(fit.residuals)) // fit.side**2
    wall = (
        "The wall's texture was learnt from all frames, cell by cell"
        if fit.textured
        else "The wall is even: a texture would not explain the frames better than chance"
    )
    notes = [f"{cells:,} cells of {fit.side} x {fit.side} pixels were fitted. {wall}."]
    if fit.misfit.share > 0:
        notes.append(
            f"The model misses {100 * fit.misfit.share:.2g} % of the light (RMS), such as texture "
            "within the cells; the standard errors contain it."
        )
    if fit.numerical_inflation > _STATED:
        notes.append(
            "Numerical errors of the lens's light enlarge the standard errors by a factor of up to "
            f"{fit.numerical_inflation:.2g}; these errors are included."
        )
    return notes


def _of_frames(fit: ImageFit) -> tuple[np.ndarray, np.ndarray]:
    """Frames with pixels, and the mean residual of each over its standard deviation."""
    known, single = _single(fit)
    count = known.sum(axis=(1, 2))
    numbers = np.flatnonzero(count)
    return numbers, single.sum(axis=(1, 2))[numbers] / np.sqrt(count[numbers])


def _maps(fit: ImageFit) -> tuple[np.ndarray, list[tuple[int, int]]]:
    """Residuals averaged over groups of frames and over neighbouring pixels, over their sigma."""
    known, single = _single(fit)
    numbers = np.flatnonzero(known.any(axis=(1, 2)))
    parts = np.array_split(numbers, min(_MAPS, numbers.size))
    width = _SMOOTHING * math.sqrt(known[numbers].sum(axis=(1, 2)).mean())
    maps = []
    for part in parts:
        # A Gaussian of sigma s is the square of one of s/sqrt(2), up to a factor 4 pi (s/sqrt 2)^2.
        count = ndimage.gaussian_filter(known[part].sum(axis=0).astype(float), width / math.sqrt(2))
        mean = ndimage.gaussian_filter(single[part].sum(axis=0), width)
        over = mean * math.sqrt(4 * math.pi) * width / np.sqrt(np.maximum(count, 1e-3))
        maps.append(np.where(known[part].any(axis=0), over, np.nan))
    return np.array(maps), [(int(part[0]), int(part[-1])) for part in parts]


def _single(fit: ImageFit) -> tuple[np.ndarray, np.ndarray]:
    """Which pixels were fitted, and residuals whose sums over squares of pixels have unit noise.

    All k x k pixels of a cell have the residual of its mean, so each counts as 1/k of it.
    """
    known = np.isfinite(fit.residuals)
    return known, np.where(known, fit.residuals, 0.0) / fit.side


def _propagated(
    follows: Float[np.ndarray, "n p"], covariance: Float[np.ndarray, "p p"]
) -> Float[np.ndarray, "n n"]:
    """Covariance of derived values; infinite if they depend on an undetermined parameter."""
    lost = np.isinf(np.diag(covariance))
    known = np.where(np.isinf(covariance), 0.0, covariance)
    result = np.asarray(follows @ known @ follows.T)
    hidden = follows[:, lost].any(axis=1)
    result[hidden, :] = result[:, hidden] = np.inf
    return result
