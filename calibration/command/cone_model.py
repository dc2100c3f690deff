"""Model cone of `eyespot fit`: the exact geometry fitted to the spots' ellipses."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from scipy.linalg import block_diag

from calibration.command.fitted import Choices, Fitted
from calibration.command.goodness import bounds_hit
from calibration.recordings import Recording
from calibration.solvers import excess_variance
from calibration.spots import ConeFit, fit_cone, fit_plane
from estimator.files import BEAM
from optics import InputError

_MISMATCHES = ("position right", "position down", "size", "elongation right", "elongation oblique")
"""The components of `optics.ellipse_mismatch` after `_along_the_image`, in words."""


def fit_cone_to_spots(recordings: Sequence[Recording], choices: Choices) -> Fitted:
    """Fit the exact geometry to planes and eyeballs together."""
    check_spots(recordings, choices)
    free = choices.free or ("half_angle", "b")
    for name in {"half_angle", "b"} - set(free):
        raise InputError(f"--free must contain half_angle and b; {name} is missing. Add it.")
    microscope = recordings[0].microscope
    planes = [r for r in recordings if r.trial.kind == "plane"]
    line = fit_plane(
        semi_minor_px=np.concatenate([np.asarray(r.trial.ellipses.semi_minor) for r in recordings]),
        distance=np.concatenate([r.trial.readings for r in recordings]),
    )
    tilt = planes[0].tilt if planes else (0.0, 0.0)
    start = {
        # The paper's line through all spots is close enough for the exact model to converge.
        "half_angle": math.atan(microscope.scale_mm_px / line.delta_k),
        "b": line.b,
        "tilt_x": tilt[0],
        "tilt_y": tilt[1],
    }
    fit = fit_cone(
        [recording.trial for recording in recordings],
        microscope.pinhole(),
        start=start,
        free=free,
        priors={name: prior for name, prior in choices.priors.items() if name != "touch"},
    )
    return fitted_cone(fit, recordings, calibration_model="exact")


def check_spots(recordings: Sequence[Recording], choices: Choices) -> None:
    """Refuse what a fit of the exact geometry cannot use.

    Raises:
        InputError: another loss, or spots without standard deviations.
    """
    if choices.loss != "squares":
        raise InputError("--robust works with the models plane and sphere only. Leave it out.")
    for recording in recordings:
        if not np.isfinite(recording.trial.covariances).all():
            raise InputError(
                f"{recording.name} has spots without standard deviations, as the literal mode "
                "writes them. The exact geometry weights spots by these. Track in the sub-pixel "
                "mode, or use --model plane."
            )


def fitted_cone(fit: ConeFit, recordings: Sequence[Recording], *, calibration_model: str) -> Fitted:
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
