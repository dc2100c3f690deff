"""Models image and lens of `eyespot fit`, fitted to every pixel of one recording."""

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Literal

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike
from scipy import ndimage

from eyespot import optics
from eyespot.calibration.command.apart import OF_ONE
from eyespot.calibration.command.choices import Choices
from eyespot.calibration.command.comparisons import pixels_against_rig, priors_against_images
from eyespot.calibration.command.fit_verdict import Fitted, PixelResiduals, bounds_hit
from eyespot.calibration.command.lens_guess import guessed_lenses
from eyespot.calibration.command.spot_models import cone_from, cone_start, free_core, known_cone
from eyespot.calibration.least_squares import propagated
from eyespot.calibration.pixels.data import CONE, FREE, LENS, UNITS, Footage, footage_of
from eyespot.calibration.pixels.fit import fit_image
from eyespot.calibration.pixels.fit_result import ImageFit
from eyespot.calibration.pixels.light import VIEW
from eyespot.calibration.recorded_trial import FREE_TOUCH, RecordedTrial
from eyespot.calibration.spots.cone_trials import (
    JointPrior,
    Prior,
    phantom_wall,
    wandering_boresight,
)
from eyespot.calibration.tolerances import (
    PriorOutcome,
    microscope_of,
    said_of_priors,
    stated_core,
    tolerances,
)
from eyespot.estimator.distance.consistency import disagreements, hints
from eyespot.estimator.run.progress_bar import progress, say
from eyespot.formats.calibration import BEAM, LENS_PARAMETERS, OF_MICROSCOPE, Calibration
from eyespot.formats.inputs import InputError
from eyespot.optics.wall_light.lens_flux import lens_parameters

_START_APERTURE = 0.05  # numerical: start value
_START_BLUR_PX = 1.0  # start value: a camera in focus
_START_SPREAD_MM = 0.03  # start value: about that of paper
_BEAM = ("boresight", "boresight_sideways")
_SECONDS = {"cone": (10.0, 3e-6), "lens": (60.0, 5e-7)}
"""Time of a fit on two cores, and its increase per pixel and frame, to a factor of two."""
_STATED = 1.05
"""Factor above which the report says that numerical errors enlarge the standard errors."""
_MAPS, _SMOOTHING = 6, 0.03
"""Number of the maps of residuals, and the sigma of their smoothing over the lit part's size."""
DROP = {
    "core_radius": Prior(0.9, 0.15),
    "aperture_radius": Prior(1.06, 0.12),
    "sag": Prior(0.0, 0.5),
}
"""A fibre's core and a drop's rim and height over the fibre's radius: cladding and jacket take up
to a quarter of it, glue may run over the edge, and glue that wets the face makes no half ball. All
three are free where neither the lens nor the free parameters are chosen."""
_HOLLOW_MM = 1e-4
"""Depth of a hollow end that counts as flat: a fifth of a wavelength, which no light shows."""
_STATED_APART = (
    *("touch", "robot_scale", "clock_offset", *VIEW),
    *("core_radius", "glue_index", "rim_height"),
)
"""What a rig states and budgets show, by the names of parameters."""
_BRIGHTNESS = ("sensitivity", "power", "reflectance")
"""Factors of a calibration file's brightness; it is their product over pi."""


def fit_image_of_cone(recordings: Sequence[RecordedTrial], choices: Choices) -> Fitted:
    """Fit half-angle and b of a cone to pixels; start with the paper's line through the spots."""
    (recording,) = recordings
    footage = _footage(recording, choices)
    own = known_cone(choices.known, recordings) if choices.known else None
    line, core = cone_start(recordings), free_core(recordings)
    if core and own is None:
        own = cone_from(core, line["half_angle"])
    start = dict(own.mean if own else line)
    if core:
        start["touch"] = start["b"] - line["b"]
    if "blur" in choices.names:
        start["blur"] = _START_BLUR_PX
    return _fitted(recording, footage, choices, "cone", [start], joint_prior=own)


def fit_image_of_lens(recordings: Sequence[RecordedTrial], choices: Choices) -> Fitted:
    """Fit shape, aperture and brightness of a glue lens to pixels.

    Starts from the lenses that resemble the spots most, among them the one that was chosen. If
    none was, the radii of core and cap are free, too.

    A lens that was calibrated before is the start instead. What its file has an error of is free.
    """
    (recording,) = recordings
    footage = _footage(recording, choices)
    if choices.known:
        if recording.trial.touch == FREE_TOUCH:
            raise InputError(
                f"{recording.name}: robot.touch is free; a lens that is known is fitted from a "
                "first distance that is known, too. Give --prior touch=MEAN,SIGMA, in mm."
            )
        start, joint = _known_lens(choices.known, choices.names)
        choices = choices.model_copy(update={"free": ",".join(choices.names or joint.mean)})
        return _fitted(recording, footage, choices, "lens", [start], joint_prior=joint)
    radius, drop, glue = recording.fibre_radius_mm, {}, {}
    tip = recording.recording.rig.instrument
    if choices.lens:
        kind = lens_parameters(optics.load_lens(choices.lens))
    else:
        drop = {name: Prior(*(radius * x for x in prior)) for name, prior in DROP.items()}
        if core := stated_core(recording):
            drop["core_radius"] = core
        drop |= {name: prior for name, prior in choices.priors.items() if name in drop}
        kind = {name: prior.mean for name, prior in drop.items()}
        # What is known exactly is not free.
        drop = {name: prior for name, prior in drop.items() if prior.sigma > 0}
        kind |= {"rim_height": 0.0, "glue_index": tip.glue_index}
        of_glue = {
            "rim_height": Prior(0.0, tip.rim_height_sigma_mm),
            "glue_index": Prior(tip.glue_index, tip.glue_index_sigma),
        }
        kind["numerical_aperture"] = _START_APERTURE
        glue = {name: prior for name, prior in of_glue.items() if prior.sigma > 0}
    starts = guessed_lenses(recording, footage, kind, drop)
    more = {} if choices.names else drop | glue
    return _fitted(recording, footage, choices, "lens", starts, more=more)


def _known_lens(
    calibration: Calibration, names: Sequence[str]
) -> tuple[dict[str, float], JointPrior]:
    """Parameters of a calibrated lens, and those known with an error, of `names` if there are any.

    Raises:
        InputError: the calibration is not of a lens, or all of its parameters are exact.
    """
    values = calibration.values
    if calibration.model != "lens":
        raise InputError(
            "--calibration must be of a lens here; got one of the model "
            f"{calibration.model!r}. Give one of a lens, or --model cone."
        )
    shape = {name: values[name] for name in LENS_PARAMETERS if name in values}
    start = lens_parameters(optics.glue_lens(**shape))
    start |= {name: values[name] for name in VIEW if name in values}
    of_file = [n for n in start if n in values and calibration.sigma(n) > 0]
    known = [name for name in of_file if not names or name in names]
    if not known and not names:
        raise InputError(
            "--calibration states no error of any parameter, so that nothing can be corrected. "
            "Name what may change with --free."
        )
    rows = [list(values).index(name) for name in known]
    covariance = calibration.covariance[np.ix_(rows, rows)]
    return start, JointPrior({name: start[name] for name in known}, covariance)


def _pose_start(recording: RecordedTrial) -> dict[str, float]:
    """Where the spots show that the beam meets the wall at reading 0, and its boresight."""
    trial, file = recording.trial, recording.microscope
    wall = phantom_wall(trial.kind, eye_radius=file.eye_radius_mm, tilt=recording.tilt)
    centres = np.asarray(trial.ellipses.centre)
    points = wall.intersect(*file.ideal_microscope().ray(centres)).point
    motion = trial.axis if trial.motion is None else trial.motion
    evenly = np.ones(len(centres))
    boresight = wandering_boresight(
        points,
        jnp.asarray(trial.readings),
        jnp.asarray(evenly),
        motion=jnp.asarray(motion),
        axis=jnp.asarray(trial.axis),
    )
    first = np.linalg.lstsq(np.stack([evenly, trial.readings], axis=1), centres, rcond=None)[0][0]
    return dict(zip(("u", "v", *_BEAM), [*first.tolist(), *boresight.tolist()], strict=True))


def _footage(recording: RecordedTrial, choices: Choices) -> Footage:
    """The images of a recording.

    Raises:
        InputError: they show a tilted plane.
    """
    if any(recording.tilt):
        raise InputError(
            f"{recording.name} shows a tilted plane. The fit to pixels supports only planes "
            "perpendicular to the microscope's axis. Use --model cone, which supports a tilt."
        )
    return footage_of(recording.recording)


def _fitted(
    recording: RecordedTrial,
    footage: Footage,
    choices: Choices,
    source: Literal["cone", "lens"],
    starts: Iterable[dict[str, float]],
    *,
    more: Mapping[str, Prior] | None = None,
    joint_prior: JointPrior | None = None,
) -> Fitted:
    """Fit, and bring the result into the form that all models share.

    The likeliest of the `starts` comes first. Parameters with a prior in `more` are free beside
    those free by default. A calibration gives the beam's `joint_prior`.
    """
    known = _pose_start(recording)
    shared = joint_prior.mean if joint_prior else ()
    tolerated = {k: v for k, v in tolerances([recording]).items() if k not in shared}
    more = {"touch": recording.trial.touch, **(more or {}), **tolerated}
    microscope = microscope_of([recording])
    in_file = {*choices.names, *shared, *(OF_MICROSCOPE if microscope else ())}
    if "spread" in choices.names:
        known["spread"] = _START_SPREAD_MM
    begins = (known | start for start in starts)
    least, per_pixel = _SECONDS[source]
    minutes = (least + footage.light.size * per_pixel) / 60
    rounded = f"about {minutes:.0f}" if minutes >= 1 else "less than 1"
    say(f"Fitting a {source} to {len(footage.readings)} frames: {rounded} min on two cores.")
    with progress("Fitting", total=None) as advance:
        fit = fit_image(
            footage,
            source=source,
            start=next(begins),
            others=begins,
            free=tuple(dict.fromkeys((*(choices.names or FREE[source]), *shared, *more))),
            priors={**more, **choices.priors},
            joint_prior=joint_prior,
            progress=lambda chi_squared: advance(note=f"chi squared {chi_squared:.4g}"),
        )

    def of_file(fitted: Mapping[str, ArrayLike]) -> dict[str, Array]:
        """The calibration's parameters; with the beam's direction, if it is determined."""
        every = {**fit.values, **fitted}
        names = [name for name in VIEW if name in fitted and name in in_file]
        if source == "cone":
            found = {name: every[name] for name in (*CONE, *names)}
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
    values = {name: float(value) for name, value in of_file(fitted).items()}
    if -_HOLLOW_MM < values.get("sag", 0.0) < 0.0:
        values["glue_length"] -= values["sag"]
        values["sag"] = 0.0
    if source == "lens":
        values["aperture_radius"] = max(values["aperture_radius"], values["core_radius"])
        values["glue_length"] = max(values["glue_length"], values["sag"])  # the rim is not sunk
    slopes = jax.jacfwd(of_file)(fitted)
    follows = np.array([[slopes[name][own] for own in fitted] for name in values])
    pixels = pixel_residuals(fit)
    compared = [*pixels_against_rig(fit, recording), *priors_against_images(_outcomes(fit))]
    own = list(fit.parameters)
    by_prior = {
        name: (follows @ fit.covariance[own.index(name)] / prior.sigma)[None]
        for name, prior in fit.priors.items()
        if math.isfinite(fit.parameters[name][1])
    }
    return Fitted(
        calibration_model="exact" if source == "cone" else "lens",
        values=values,
        covariance=propagated(follows, fit.covariance),
        stated={name: rows for name, rows in by_prior.items() if name in _STATED_APART},
        shared={name: rows for name, rows in by_prior.items() if name not in OF_ONE},
        microscope=microscope if {*OF_MICROSCOPE} & {*values} - {*choices.names} else "",
        converged=fit.converged,
        failed=fit.failed,
        bounds=bounds_hit(values),
        undetermined=fit.undetermined,
        chi_squared=fit.chi_squared,
        degrees_of_freedom=fit.degrees_of_freedom,
        residuals={},
        disagreements=disagreements(compared),
        recordings=[recording],
        used=len(pixels.frames),
        others=[
            (name, value, error, UNITS[name])
            for name, (value, error) in fit.parameters.items()
            if name not in (*CONE, *LENS, *values)
        ],
        notes=_notes(fit) + hints(compared),
        pixels=pixels,
    )


def _notes(fit: ImageFit) -> list[str]:
    """What was fitted, and what enlarged the standard errors."""
    cells = np.count_nonzero(np.isfinite(fit.residuals)) // fit.side**2
    wall = (
        "The wall's texture was learnt from all frames, cell by cell"
        if fit.textured
        else "The wall is even: a texture would not explain the frames better than chance"
    )
    notes = [
        f"{cells:,} cells of {fit.side} x {fit.side} pixels were fitted. {wall}.",
        f"The standard errors are up to {fit.over_bound:.2g} times those that the camera's noise "
        "allows on a wall that nobody knows (Cramér-Rao bound).",
    ]
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
    return notes + said_of_priors(_outcomes(fit))


def _outcomes(fit: ImageFit) -> list[PriorOutcome]:
    """What a rig states, and what was found."""
    return [
        PriorOutcome(name, prior, *fit.parameters[name])
        for name, prior in fit.priors.items()
        if name in _STATED_APART
    ]


def pixel_residuals(fit: ImageFit) -> PixelResiduals:
    """Residuals averaged over groups of frames and neighbouring pixels, and over each frame."""
    known = np.isfinite(fit.residuals)
    # All k x k pixels of a cell have the residual of its mean, so each counts as 1/k of it. Then
    # sums over squares of pixels have unit noise.
    single = np.where(known, fit.residuals, 0.0) / fit.side
    count = known.sum(axis=(1, 2))
    numbers = np.flatnonzero(count)
    parts = np.array_split(numbers, min(_MAPS, numbers.size))
    width = _SMOOTHING * math.sqrt(count[numbers].mean())
    maps = []
    for part in parts:
        # A Gaussian of sigma s is the square of one of s/sqrt(2), up to a factor 4 pi (s/sqrt 2)^2.
        near = ndimage.gaussian_filter(known[part].sum(axis=0).astype(float), width / math.sqrt(2))
        mean = ndimage.gaussian_filter(single[part].sum(axis=0), width)
        over = mean * math.sqrt(4 * math.pi) * width / np.sqrt(np.maximum(near, 1e-3))
        maps.append(np.where(known[part].any(axis=0), over, np.nan))
    return PixelResiduals(
        maps=np.array(maps),
        groups=[(int(part[0]), int(part[-1])) for part in parts],
        frames=numbers,
        of_frames=single.sum(axis=(1, 2))[numbers] / np.sqrt(count[numbers]),
        misfit=fit.misfit,
    )
