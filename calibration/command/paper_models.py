"""Models plane and sphere of `eyespot fit`: the fits of Zhou et al. 2020."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

import optics
from calibration.command.choices import Choices
from calibration.command.fitted import Curve, Fitted
from calibration.recordings import Recording
from calibration.spots import (
    Loss,
    PlaneFit,
    PlaneTrial,
    PlaneTrialsFit,
    fit_eccentricity,
    fit_plane,
    fit_plane_trials,
    phantom_wall,
)
from optics import InputError

_TILT_SIGMA = math.tan(math.radians(1.0))  # of a plane phantom that was set up by eye


def line_through(recordings: Sequence[Recording], loss: Loss = "squares") -> PlaneFit:
    """The paper's line through the spots of all recordings."""
    return fit_plane(
        semi_minor_px=np.concatenate([np.asarray(r.trial.ellipses.semi_minor) for r in recordings]),
        distance=np.concatenate([r.trial.readings for r in recordings]),
        loss=loss,
    )


def fit_planes(recordings: Sequence[Recording], choices: Choices) -> Fitted:
    """Fit the paper's line through all planes, with each trial's touch and the plane's tilt."""
    for recording in recordings:
        if recording.trial.kind != "plane":
            raise InputError(
                f"the model plane needs recordings of planes; {recording.name} shows an eyeball. "
                "Leave it out, or use --model sphere or cone."
            )
    planes, pooled, notes = _pooled_planes(recordings, choices.loss)
    scale = planes[0].microscope.scale_mm_px
    to_k = np.diag([1.0 / scale, 1.0])
    names = [recording.name for recording in planes]
    touches = zip(names, pooled.touch, pooled.touch_error, strict=True)
    lines = {}
    for recording in planes:
        line = line_through([recording], choices.loss)
        axis = np.sort(np.asarray(recording.trial.ellipses.semi_minor))
        lines[recording.name] = Curve(axis, line.delta_k * axis + line.b, line.band(axis))
    return Fitted(
        calibration_model="planar",
        values={"k": pooled.delta_k / scale, "b": pooled.b},
        covariance=to_k @ pooled.covariance @ to_k,
        converged=pooled.converged,
        residuals={"the distance": pooled.residuals / pooled.noise},
        recordings=planes,
        used=pooled.residuals.size,
        degrees_of_freedom=pooled.residuals.size - 2,
        others=[
            *((f"touch of {name}", touch, error, "mm") for name, touch, error in touches),
            ("tilt_x", pooled.tilt[0], pooled.tilt_error[0], "1"),
            ("tilt_y", pooled.tilt[1], pooled.tilt_error[1], "1"),
            ("noise of a distance", pooled.noise, math.nan, "mm"),
        ],
        notes=[f"All planes: R² {pooled.r_squared:.5f}, RMSE {pooled.rmse:.4f} mm.", *notes],
        lines=lines,
    )


def fit_sphere(recordings: Sequence[Recording], choices: Choices) -> Fitted:
    """Fit the paper's c of one eyeball trial, given the line through the planes."""
    spheres = [r for r in recordings if r.trial.kind == "eyeball"]
    if len(spheres) != 1:
        raise InputError(
            "the model sphere needs one recording of an eyeball, and planes; got "
            f"{len(spheres)} eyeballs. A calibration has one eccentricity: fit each by itself."
        )
    _, pooled, notes = _pooled_planes(recordings, choices.loss)
    (sphere,) = spheres
    microscope, trial = sphere.microscope, sphere.trial
    scale, radius = microscope.scale_mm_px, microscope.eye_radius_mm
    axis = np.asarray(trial.ellipses.semi_minor)
    # The plane's b is relative to the wall, so add the touch to the eyeball's readings, too.
    distance = trial.readings + trial.touch.mean
    fit = fit_eccentricity(
        semi_minor_px=axis,
        distance=distance,
        delta_k=pooled.delta_k,
        b=pooled.b,
        scale=scale,
        eye_radius=radius,
        loss=choices.loss,
    )
    model = optics.small_plane_distance(
        semi_minor_px=axis,
        scale=scale,
        k=pooled.delta_k / scale,
        b=pooled.b,
        eccentricity=fit.c,
        eye_radius=radius,
    )
    errors = np.asarray(model) - distance
    notes = [
        f"{sphere.name}: SD {fit.standard_deviation:.4f}, mean absolute error "
        f"{fit.mean_absolute_error:.4f}, largest error {fit.max_error:.4f} mm.",
        *_outlier_note(sphere, fit.outliers),
        f"All planes: R² {pooled.r_squared:.5f}, RMSE {pooled.rmse:.4f} mm.",
        *notes,
    ]
    # c depends on the line with which it was fitted.
    follows = np.vstack([np.eye(2), fit.sensitivity])
    covariance = follows @ pooled.covariance @ follows.T
    covariance[2, 2] += fit.c_error**2
    to_k = np.diag([1.0 / scale, 1.0, 1.0])
    order = np.argsort(axis)
    band = fit.band(axis[order], delta_k=pooled.delta_k, scale=scale, eye_radius=radius)
    return Fitted(
        calibration_model="small_plane",
        values={"k": pooled.delta_k / scale, "b": pooled.b, "eccentricity": fit.c},
        covariance=to_k @ covariance @ to_k,
        converged=pooled.converged and fit.converged,
        bounds=("eccentricity = 0, where the fit is best",) if fit.at_bound else (),
        residuals={"the distance": errors / np.sqrt(np.sum(errors**2) / (errors.size - 1))},
        recordings=[sphere],
        used=errors.size + pooled.residuals.size,
        degrees_of_freedom=errors.size - 1,
        notes=notes,
        lines={sphere.name: Curve(axis[order], np.asarray(model)[order], band)},
    )


def _pooled_planes(
    recordings: Sequence[Recording], loss: Loss
) -> tuple[list[Recording], PlaneTrialsFit, list[str]]:
    """The planes' recordings, the line through them, and a sentence about each."""
    planes = [r for r in recordings if r.trial.kind == "plane"]
    if not planes:
        raise InputError("the model needs a recording of a plane; all of these show eyeballs.")
    if any(any(recording.tilt) for recording in planes):
        raise InputError(
            f"{planes[0].name} shows a tilted plane. The paper's line is valid only for a plane "
            "perpendicular to the microscope's axis. Use --model cone, which supports a tilt."
        )
    notes, trials, kept = [], [], []
    wall = phantom_wall("plane", eye_radius=planes[0].microscope.eye_radius_mm)
    for recording in planes:
        fit = line_through([recording], loss)
        notes.append(
            f"{recording.name} by itself: δk {fit.delta_k:.6f} ± {fit.delta_k_error:.6f} mm/px, b "
            f"{fit.b:.4f} ± {fit.b_error:.4f} mm, R² {fit.r_squared:.5f}, RMSE {fit.rmse:.4f} mm."
        )
        notes += _outlier_note(recording, fit.outliers)
        inliers = np.setdiff1d(np.arange(recording.trial.readings.size), fit.outliers)
        trial = replace(
            recording.trial,
            ellipses=optics.Ellipse(*(leaf[inliers] for leaf in recording.trial.ellipses)),
            covariances=recording.trial.covariances[inliers],
            readings=recording.trial.readings[inliers],
        )
        kept.append(recording._replace(trial=trial))
        centre = np.asarray(trial.ellipses.centre).mean(axis=0)
        ray = recording.microscope.ideal_microscope().ray(centre)
        angle = np.asarray(trial.ellipses.angle)
        trials.append(
            PlaneTrial(
                semi_minor_px=np.asarray(trial.ellipses.semi_minor),
                readings=trial.readings,
                # Perpendicular to (cos, sin) in the image, whose v points towards -Y.
                minor_axes=np.stack([np.sin(angle), np.cos(angle)], axis=-1),
                place=np.asarray(wall.intersect(*ray).point[:2]),
                touch=trial.touch,
            )
        )
    pooled = fit_plane_trials(
        trials,
        inverse_working_distance=planes[0].microscope.inverse_working_distance,
        tilt_sigma=_TILT_SIGMA,
    )
    return kept, pooled, notes


def _outlier_note(recording: Recording, outliers: tuple[int, ...]) -> list[str]:
    if not outliers:
        return []
    readings = ", ".join(f"{recording.trial.readings[i]:.2f}" for i in outliers)
    return [f"{recording.name}: {len(outliers)} outliers, at readings of {readings} mm."]
