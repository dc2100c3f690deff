"""Model eye of `eyespot fit`: how an unknown eye shows the spots of a known cone."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from calibration.command.cone_model import check_spots, fitted_cone
from calibration.command.fitted import Choices, Fitted
from calibration.recordings import Recording
from calibration.spots import OUTLINE_PER_MM, RETINA, SIZE_PER_MM, JointPrior, fit_cone
from estimator.files import Calibration
from optics import InputError

EYE = ("half_angle", "b", "scale", "inverse_working_distance", "eye_radius")
"""What is fitted: the cone, which is known, and the pinhole and the sphere that are not."""


def fit_eye(recordings: Sequence[Recording], choices: Choices) -> Fitted:
    """Fit pinhole and sphere that stand for an eye and its viewing lens to withdrawals in it."""
    check_spots(recordings, choices)
    cone = choices.cone
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
    priors = {"eye_radius": RETINA} | {
        name: prior for name, prior in choices.priors.items() if name != "touch"
    }
    for name in own.mean.keys() & priors.keys():
        raise InputError(f"--prior {name} is given twice, as --cone contains it. Leave it out.")
    free = choices.free or EYE
    for name in own.mean.keys() - set(free):
        raise InputError(f"--free must contain half_angle and b; {name} is missing. Add it.")
    microscope = recordings[0].microscope
    eccentricities = np.array([_eccentricity(recording) for recording in recordings])
    fit = fit_cone(
        [recording.trial for recording in recordings],
        microscope.pinhole(),
        start=dict(own.mean) | {"eye_radius": priors["eye_radius"].mean},
        free=free,
        priors=priors,
        joint_prior=own,
        size_sigmas=(SIZE_PER_MM * eccentricities).tolist(),
        outline_sigmas=(OUTLINE_PER_MM * eccentricities).tolist(),
    )
    return fitted_cone(fit, recordings, calibration_model="area")


def _eccentricity(recording: Recording) -> float:
    """c to a few percent, which are those of the microscope file's scale."""
    trial = recording.trial
    offset = np.asarray(trial.ellipses.centre[0]) - trial.principal_point
    return recording.microscope.scale_mm_px * float(np.hypot(*offset))


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
