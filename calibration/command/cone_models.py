"""Models cone and eye of `eyespot fit`: the exact geometry fitted to the spots' ellipses.

The model eye says how an unknown eye shows the spots of a known cone.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from scipy.linalg import block_diag

from calibration.command.choices import Choices
from calibration.command.fitted import Fitted, bounds_hit
from calibration.command.paper_models import line_through
from calibration.pixels import CONE
from calibration.recordings import Recording
from calibration.solvers import excess_variance
from calibration.spots import (
    OUTLINE_PER_MM,
    RETINA,
    SIZE_PER_MM,
    ConeFit,
    JointPrior,
    Prior,
    fit_cone,
)
from estimator.files import BEAM, Calibration
from optics import InputError

EYE = ("half_angle", "b", "scale", "inverse_working_distance", "eye_radius")
"""What is fitted: the cone, which is known, and the pinhole and the sphere that are not."""
_MISMATCHES = ("position right", "position down", "size", "elongation right", "elongation oblique")
"""The components of `optics.ellipse_mismatch` after `_along_the_image`, in words."""


def cone_start(recordings: Sequence[Recording]) -> dict[str, float]:
    """The paper's line through all spots, which is close enough for the exact model to converge."""
    line = line_through(recordings)
    half_angle = math.atan(recordings[0].microscope.scale_mm_px / line.delta_k)
    return {"half_angle": half_angle, "b": line.b}


def fit_cone_to_spots(recordings: Sequence[Recording], choices: Choices) -> Fitted:
    """Fit the exact geometry to planes and eyeballs together."""
    _require_errors(recordings)
    tilts = [recording.tilt for recording in recordings if recording.trial.kind == "plane"]
    tilt = dict(zip(("tilt_x", "tilt_y"), tilts[0] if tilts else (0.0, 0.0), strict=True))
    fit = fit_cone(
        [recording.trial for recording in recordings],
        recordings[0].microscope.pinhole(),
        start=cone_start(recordings) | tilt,
        free=choices.names or CONE,
        priors=_without_touch(choices),
    )
    return _fitted(fit, recordings, calibration_model="exact")


def _without_touch(choices: Choices) -> dict[str, Prior]:
    return {name: prior for name, prior in choices.priors.items() if name != "touch"}


def _require_errors(recordings: Sequence[Recording]) -> None:
    for recording in recordings:
        if not np.isfinite(recording.trial.covariances).all():
            raise InputError(
                f"{recording.name} has spots without standard deviations, as the literal mode "
                "writes them. The exact geometry weights spots by these. Track in the sub-pixel "
                "mode, or use --model plane."
            )


def _fitted(fit: ConeFit, recordings: Sequence[Recording], *, calibration_model: str) -> Fitted:
    """The result of `fit_cone` in the form that all models share."""
    kept = [i for i, name in enumerate(fit.free) if name not in ("tilt_x", "tilt_y")]
    values = {fit.free[i]: fit.values[fit.free[i]] for i in kept}
    covariance = fit.covariance[np.ix_(kept, kept)]
    if len(recordings) == 1 and np.isfinite(fit.boresight_covariance).all():
        # Several trials may have been made with several tools.
        slopes = recordings[0].beam_slopes
        values |= dict(zip(BEAM, (slopes @ fit.boresight[0]).tolist(), strict=True))
        of_beam = slopes @ fit.boresight_covariance[0] @ slopes.T
        covariance = block_diag(covariance, of_beam)
    grown = excess_variance(fit.chi_squared / fit.degrees_of_freedom, fit.degrees_of_freedom)
    growth = math.sqrt(grown)
    sigma = growth * np.sqrt(np.diag(fit.covariance))
    names = [recording.name for recording in recordings]
    touches = zip(names, fit.touch, growth * fit.touch_error, strict=True)
    eccentricities = [
        (f"c of {recording.name}", c, error, "mm")
        for recording, c, error in zip(
            recordings, fit.eccentricity, growth * fit.eccentricity_error, strict=True
        )
        if recording.trial.kind == "eyeball"
    ]
    residuals = np.concatenate(
        [
            _along_the_image(residual, np.asarray(recording.trial.ellipses.angle))
            for residual, recording in zip(fit.residuals, recordings, strict=True)
        ]
    )
    return Fitted(
        calibration_model=calibration_model,
        values=values,
        covariance=grown * covariance,
        converged=fit.converged,
        bounds=bounds_hit(values),
        undetermined=fit.undetermined,
        chi_squared=fit.chi_squared,
        degrees_of_freedom=fit.degrees_of_freedom,
        residuals=dict(zip(_MISMATCHES, residuals.T, strict=True)),
        recordings=recordings,
        used=len(residuals),
        others=[
            *(
                (name, fit.values[name], float(sigma[i]), "1")
                for i, name in enumerate(fit.free)
                if i not in kept
            ),
            *((f"touch of {name}", touch, error, "mm") for name, touch, error in touches),
            *eccentricities,
        ],
        notes=[
            f"{name}: the beam points {math.degrees(np.hypot(*boresight)):.2f}° off the tool's "
            f"axis. The robot is rotated by {math.degrees(np.hypot(*lean)):.2f}° against the eye."
            for name, boresight, lean in zip(names, fit.boresight, fit.lean, strict=True)
        ],
    )


def _along_the_image(residuals: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Mismatches in the directions of the image instead of those of each measured ellipse.

    Noise makes every measured circle an ellipse, and along its own axis that ellipse is always too
    long, so that residuals there have one sign and look as if they had structure.

    Args:
        residuals: n x 5, as `ConeFit.residuals`.
        angle: of the measured ellipses' major axes, n, rad.
    """
    u, v, size, long, oblique = residuals.T
    once, twice = np.exp(1j * angle), np.exp(2j * angle)
    place, shape = once * (u + 1j * v), twice * (long + 1j * oblique)
    return np.stack([place.real, place.imag, size, shape.real, shape.imag], axis=1)


def fit_eye(recordings: Sequence[Recording], choices: Choices, cone: Calibration | None) -> Fitted:
    """Fit pinhole and sphere that stand for an eye and its viewing lens to withdrawals in it."""
    _require_errors(recordings)
    if cone is None:
        raise InputError(
            "--model eye needs --cone FILE: a calibration of the same fibre in the same medium. "
            "Fit one to recordings of a phantom with --model cone."
        )
    for recording in recordings:
        if recording.trial.kind != "eyeball":
            raise InputError(
                f"{recording.name} was taken on a plane, which does not belong to the eye. Fit it "
                "by itself with --model cone, and give the result with --cone."
            )
        if recording.medium != cone.medium:
            raise InputError(
                f"{recording.name} was taken in {recording.medium}, but --cone is valid in "
                f"{cone.medium}. Calibrate the cone in {recording.medium}."
            )
    own = _cone(cone)
    priors = {"eye_radius": RETINA} | _without_touch(choices)
    for name in own.mean.keys() & priors.keys():
        raise InputError(f"--prior {name} is given twice, as --cone contains it. Leave it out.")
    microscope = recordings[0].microscope
    # c to a few percent, which are those of the microscope file's scale.
    offsets = [
        np.hypot(*np.asarray(one.trial.ellipses.centre[0]) - one.trial.principal_point)
        for one in recordings
    ]
    eccentricities = microscope.scale_mm_px * np.array(offsets)
    fit = fit_cone(
        [recording.trial for recording in recordings],
        microscope.pinhole(),
        start=dict(own.mean) | {"eye_radius": priors["eye_radius"].mean},
        free=choices.names or EYE,
        priors=priors,
        joint_prior=own,
        size_sigmas=(SIZE_PER_MM * eccentricities).tolist(),
        outline_sigmas=(OUTLINE_PER_MM * eccentricities).tolist(),
    )
    return _fitted(fit, recordings, calibration_model="area")


def _cone(calibration: Calibration) -> JointPrior:
    """half_angle and b of a calibration."""
    values = calibration.values
    if "b" not in values or not {"k", "half_angle"} & values.keys():
        raise InputError(
            f"--cone must be a calibration of a cone; got one of the model {calibration.model!r}. "
            "Fit a phantom with --model cone."
        )
    name = "half_angle" if "half_angle" in values else "k"
    rows = [list(values).index(row) for row in (name, "b")]
    covariance = calibration.covariance[np.ix_(rows, rows)]
    angle = values[name]
    if name == "k":
        # half_angle = atan(1/k)
        slopes = np.diag([-1.0 / (1.0 + angle**2), 1.0])
        covariance, angle = slopes @ covariance @ slopes, math.atan(1.0 / angle)
    return JointPrior({"half_angle": angle, "b": values["b"]}, covariance)
