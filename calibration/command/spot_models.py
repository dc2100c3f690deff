"""Fits to spots: the cone, and the models of the paper."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.linalg import block_diag

from eyespot import optics
from eyespot.calibration.command.choices import Choices
from eyespot.calibration.command.comparisons import cone_against_rig, priors_against_images
from eyespot.calibration.command.fit_verdict import Fitted, bounds_hit
from eyespot.calibration.pixels.data import CONE, UNITS
from eyespot.calibration.recorded_trial import FREE_TOUCH, RecordedTrial
from eyespot.calibration.spots.cone_fit import MISMATCHES, ConeFit, fit_cone
from eyespot.calibration.spots.cone_trials import (
    OUTLINE_PER_MM,
    RETINA,
    SIZE_PER_MM,
    SIZE_SIGMA,
    ConeTrial,
    JointPrior,
    Prior,
    phantom_wall,
)
from eyespot.calibration.spots.paper_fits import (
    Loss,
    PlaneFit,
    PlaneTrial,
    PlaneTrialsFit,
    fit_eccentricity,
    fit_plane,
    fit_plane_trials,
)
from eyespot.calibration.tolerances import (
    OF_ROBOT,
    PriorOutcome,
    microscope_of,
    said_of_priors,
    stated_core,
    tolerances,
)
from eyespot.estimator.distance.consistency import disagreements, hints
from eyespot.formats.calibration import BEAM, OF_MICROSCOPE, QUANTITIES, Calibration
from eyespot.formats.inputs import InputError

_PLANE_TILT_SIGMA = math.tan(math.radians(1.0))  # slope; a plane phantom is set up by eye


def line_through(recordings: Sequence[RecordedTrial], loss: Loss = "squares") -> PlaneFit:
    """The paper's line through the spots of all recordings."""
    return fit_plane(
        semi_minor_px=np.concatenate([np.asarray(r.trial.ellipses.semi_minor) for r in recordings]),
        distance=np.concatenate([r.trial.readings for r in recordings]),
        loss=loss,
    )


def fit_planes(recordings: Sequence[RecordedTrial], choices: Choices) -> Fitted:
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
        lines[recording.name] = (axis, line.delta_k * axis + line.b, line.band(axis))
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
        notes=notes,
        lines=lines,
    )


def fit_sphere(recordings: Sequence[RecordedTrial], choices: Choices) -> Fitted:
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
    known: dict[str, Any] = {"b": pooled.b, "scale": scale, "eye_radius": radius}
    known["semi_minor_px"] = axis
    fit = fit_eccentricity(**known, distance=distance, delta_k=pooled.delta_k, loss=choices.loss)
    model = optics.small_plane_distance(**known, k=pooled.delta_k / scale, eccentricity=fit.c)
    errors = np.asarray(model) - distance
    notes = [
        f"{sphere.name}: SD {fit.standard_deviation:.4f}, mean absolute error "
        f"{fit.mean_absolute_error:.4f}, largest error {fit.max_error:.4f} mm.",
        *_outlier_note(sphere, fit.outliers),
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
        lines={sphere.name: (axis[order], np.asarray(model)[order], band)},
    )


def _pooled_planes(
    recordings: Sequence[RecordedTrial], loss: Loss
) -> tuple[list[RecordedTrial], PlaneTrialsFit, list[str]]:
    """The planes' recordings, the line through them, and a sentence about it and about each."""
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
        kept.append(recording.only(inliers))
        trial = kept[-1].trial
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
        tilt_sigma=_PLANE_TILT_SIGMA,
    )
    notes.insert(0, f"All planes: R² {pooled.r_squared:.5f}, RMSE {pooled.rmse:.4f} mm.")
    return kept, pooled, notes


def _outlier_note(recording: RecordedTrial, outliers: tuple[int, ...]) -> list[str]:
    if not outliers:
        return []
    readings = ", ".join(f"{recording.trial.readings[i]:.2f}" for i in outliers)
    return [f"{recording.name}: {len(outliers)} outliers, at readings of {readings} mm."]


EYE = ("half_angle", "b", "scale", "inverse_working_distance", "eye_radius")
"""What is fitted: the cone, which is known, and the pinhole and the sphere that are not."""


def cone_start(recordings: Sequence[RecordedTrial]) -> dict[str, float]:
    """The paper's line through all spots, which is close enough for the exact model to converge."""
    line = line_through(recordings)
    half_angle = math.atan(recordings[0].microscope.scale_mm_px / line.delta_k)
    return {"half_angle": half_angle, "b": line.b}


def fit_cone_to_spots(recordings: Sequence[RecordedTrial], choices: Choices) -> Fitted:
    """Fit the exact geometry to planes and eyeballs together."""
    _require_errors(recordings)
    tilts = [recording.tilt for recording in recordings if recording.trial.kind == "plane"]
    tilt = dict(zip(("tilt_x", "tilt_y"), tilts[0] if tilts else (0.0, 0.0), strict=True))
    own = known_cone(choices.known, recordings) if choices.known else None
    shared = own.mean.keys() if own else ()
    priors = {k: v for k, v in tolerances(recordings).items() if k not in shared}
    free = tuple(dict.fromkeys((*(choices.names or CONE), *shared, *priors)))
    priors |= _without_touch(choices)
    core = None if own else free_core(recordings)
    start = dict(own.mean) if own else cone_start(recordings)
    for _ in range(_CORE_ROUNDS if core else 1):
        joint = own if core is None else cone_from(core, start["half_angle"])
        trials = [recording.sharp_trial for recording in recordings]
        if core and joint:
            trials = [_begun(recording, joint.mean["b"]) for recording in recordings]
        fit = fit_cone(
            trials,
            recordings[0].microscope.pinhole(),
            start=start | (dict(joint.mean) if joint else {}) | tilt,
            free=free,
            priors=priors,
            joint_prior=joint,
            size_sigmas=[SIZE_SIGMA] * len(recordings),
        )
        start = start | {"half_angle": fit.values["half_angle"]}
    return _fitted(
        fit, recordings, choices.names or CONE, priors, calibration_model="exact", core=core
    )


_CORE_ROUNDS = 3
"""Fits whose start is the half-angle of the one before. The first is off by what the line through
the spots misses, some percent; each next one squares that."""
_ANY_ANGLE = 0.5
"""Standard deviation, rad, of a half-angle of which nothing is known."""


def _begun(recording: RecordedTrial, b: float) -> ConeTrial:
    """A trial whose free first distance is expected where the line through its spots begins.

    The line is d = k R + b of the readings, which lack the first distance. From one that is some
    millimetres off, the solver goes astray.
    """
    trial = recording.sharp_trial
    if trial.touch != FREE_TOUCH:
        return trial
    return replace(trial, touch=Prior(b - line_through([recording]).b, FREE_TOUCH.sigma))


def free_core(recordings: Sequence[RecordedTrial]) -> Prior | None:
    """Radius of the core on which the distances rest where no first distance is known.

    Raises:
        InputError: neither is stated.
    """
    if not any(one.trial.touch == FREE_TOUCH for one in recordings):
        return None
    core = stated_core(recordings[0])
    if core is None:
        raise InputError(
            f"{recordings[0].name}: robot.touch is free, so that nothing says how far the tip was. "
            "State instrument.core_radius_mm, on which the distances then rest; or the first "
            "distance, --prior touch=MEAN,SIGMA; or begin at contact."
        )
    return core


def cone_from(core: Prior, half_angle: float) -> JointPrior:
    """A cone of any half-angle that leaves a core of this radius: b = -radius / tan(half_angle).

    Linear about a half-angle, rad.
    """
    slope = core.mean / math.sin(half_angle) ** 2
    across = np.array([1.0, slope]) * _ANY_ANGLE
    covariance = np.outer(across, across)
    covariance[1, 1] += (core.sigma / math.tan(half_angle)) ** 2
    mean = {"half_angle": half_angle, "b": -core.mean / math.tan(half_angle)}
    return JointPrior(mean, covariance)


def _moved_by_core(fit: ConeFit, core: Prior) -> np.ndarray:
    """How far the fitted parameters follow a standard deviation of the core's radius, (1, p)."""
    angle, b = fit.values["half_angle"], fit.values["b"]
    slopes = {"half_angle": -b / math.cos(angle) ** 2, "b": -math.tan(angle)}
    gradient = np.array([slopes.get(name, 0.0) for name in fit.free])
    return np.asarray(gradient @ fit.covariance / core.sigma)[None]


def _without_touch(choices: Choices) -> dict[str, Prior]:
    return {name: prior for name, prior in choices.priors.items() if name != "touch"}


def _require_errors(recordings: Sequence[RecordedTrial]) -> None:
    for recording in recordings:
        if not np.isfinite(recording.trial.covariances).all():
            raise InputError(
                f"{recording.name} has spots without standard deviations, as the literal mode "
                "writes them. The exact geometry weights spots by these. Track in the sub-pixel "
                "mode, or use --model plane."
            )


def _unit_of(name: str) -> str:
    return QUANTITIES[name].unit if name in QUANTITIES else UNITS.get(name, "1")


def _fitted(
    fit: ConeFit,
    recordings: Sequence[RecordedTrial],
    asked: Sequence[str],
    priors: Mapping[str, Prior],
    *,
    calibration_model: str,
    core: Prior | None = None,
) -> Fitted:
    """The result of `fit_cone` in the form that all models share.

    Args:
        asked: parameters that were chosen; the others are free because of a tolerance.
    """
    microscope = microscope_of(recordings)
    in_file = (*asked, *OF_MICROSCOPE) if microscope else asked
    kept = [i for i, name in enumerate(fit.free) if name in QUANTITIES and name in in_file]
    values = {fit.free[i]: fit.values[fit.free[i]] for i in kept}
    covariance = fit.covariance[np.ix_(kept, kept)]
    stated = {name: rows[:, kept] for name, rows in fit.stated.items()}
    if core is not None:
        stated["core_radius"] = _moved_by_core(fit, core)[:, kept]
    if len(recordings) == 1 and np.isfinite(fit.boresight_covariance).all():
        # Several trials may have been made with several tools.
        slopes = recordings[0].beam_slopes
        values |= dict(zip(BEAM, (slopes @ fit.boresight[0]).tolist(), strict=True))
        of_beam = slopes @ fit.boresight_covariance[0] @ slopes.T
        covariance = block_diag(covariance, of_beam)
        stated = {name: np.pad(rows, ((0, 0), (0, 2))) for name, rows in stated.items()}
    sigma = dict(zip(fit.free, np.sqrt(np.diag(fit.covariance)).tolist(), strict=True))
    names = [recording.name for recording in recordings]
    touches = zip(names, fit.touch, fit.touch_error, strict=True)
    eccentricities = [
        (f"c of {recording.name}", c, error, "mm")
        for recording, c, error in zip(
            recordings, fit.eccentricity, fit.eccentricity_error, strict=True
        )
        if recording.trial.kind == "eyeball"
    ]
    known = [PriorOutcome(n, p, fit.values[n], sigma[n]) for n, p in priors.items() if n in sigma]
    compared = [*cone_against_rig(fit, recordings), *priors_against_images(known)]
    known += [
        PriorOutcome(f"touch of {name}", one.trial.touch, touch, error)
        for one, name, touch, error in zip(
            recordings, names, fit.touch, fit.touch_error, strict=True
        )
        if one.trial.touch != FREE_TOUCH
    ]
    residuals = np.concatenate(fit.residuals)
    return Fitted(
        calibration_model=calibration_model,
        values=values,
        covariance=covariance,
        stated=stated,
        microscope=microscope if {*OF_MICROSCOPE} & {*values} - {*asked} else "",
        growth=fit.growth,
        converged=fit.converged,
        bounds=bounds_hit(values),
        undetermined=fit.undetermined,
        chi_squared=fit.chi_squared,
        degrees_of_freedom=fit.degrees_of_freedom,
        residuals=dict(zip(MISMATCHES, residuals.T, strict=True)),
        disagreements=disagreements(compared),
        recordings=recordings,
        used=len(residuals),
        others=[
            *(
                (name, fit.values[name], sigma[name], _unit_of(name))
                for name in fit.free
                if name not in values
            ),
            *((f"touch of {name}", touch, error, "mm") for name, touch, error in touches),
            *eccentricities,
        ],
        notes=[
            f"{name}: the beam points {math.degrees(np.hypot(*boresight)):.2f}° off the tool's "
            f"axis. The robot is rotated by {math.degrees(np.hypot(*lean)):.2f}° against the eye."
            for name, boresight, lean in zip(names, fit.boresight, fit.lean, strict=True)
        ]
        + [
            f"{recording.name}: b rests on the distance of the first frame, taken as "
            f"{recording.trial.touch.mean:.3f} ± {recording.trial.touch.sigma:.3f} mm."
            for recording in recordings
            if calibration_model == "exact" and core is None
        ]
        + [
            f"{name}: the view shakes by {by:.2g} px from frame to frame, which the spots' errors "
            "contain."
            for name, by in zip(names, fit.shake_px, strict=True)
            if by > 0
        ]
        + [
            f"The {halves} spots, each with a cone of their own: p = {chance:.2g} that it is one."
            for halves, chance in fit.halves.items()
        ]
        + [f"b rests on the core's radius, {c.mean:.4g} ± {c.sigma:.2g} mm." for c in (core,) if c]
        + said_of_priors(known)
        + hints(compared),
    )


def fit_eye(
    recordings: Sequence[RecordedTrial], choices: Choices, cone: Calibration | None
) -> Fitted:
    """Fit pinhole and sphere that stand for an eye and its viewing lens to withdrawals in it."""
    _require_errors(recordings)
    if cone is None:
        raise InputError(
            "--model eye needs --calibration FILE: of the same fibre in the same medium. Fit one "
            "to recordings of a phantom with --model cone."
        )
    for recording in recordings:
        if recording.trial.kind != "eyeball":
            raise InputError(
                f"{recording.name} was taken on a plane, which does not belong to the eye. Fit it "
                "by itself with --model cone, and give the result with --calibration."
            )
    own = known_cone(cone, recordings)
    of_robot = {
        name: prior
        for name, prior in tolerances(recordings).items()
        if name in OF_ROBOT and name not in own.mean
    }
    priors = {"eye_radius": RETINA} | of_robot | _without_touch(choices)
    microscope = recordings[0].microscope
    # c to a few percent, which are those of the microscope file's scale.
    offsets = [
        np.hypot(*np.asarray(one.trial.ellipses.centre[0]) - one.trial.principal_point)
        for one in recordings
    ]
    eccentricities = microscope.scale_mm_px * np.array(offsets)
    fit = fit_cone(
        [recording.sharp_trial for recording in recordings],
        microscope.pinhole(),
        start=dict(own.mean) | {"eye_radius": priors["eye_radius"].mean},
        free=tuple(dict.fromkeys((*(choices.names or EYE), *own.mean, *of_robot))),
        priors=priors,
        joint_prior=own,
        size_sigmas=(SIZE_PER_MM * eccentricities).tolist(),
        outline_sigmas=(OUTLINE_PER_MM * eccentricities).tolist(),
    )
    return _fitted(fit, recordings, choices.names or EYE, priors, calibration_model="area")


def known_cone(calibration: Calibration, recordings: Sequence[RecordedTrial]) -> JointPrior:
    """half_angle and b of a calibration in the recordings' medium."""
    values = calibration.values
    if "b" not in values or not {"k", "half_angle"} & values.keys():
        raise InputError(
            "--calibration must be of a cone here; got one of the model "
            f"{calibration.model!r}. Fit a phantom with --model cone."
        )
    medium = recordings[0].medium
    if medium != calibration.medium.name:
        raise InputError(
            f"{recordings[0].name} was taken in {medium}, but --calibration is valid in "
            f"{calibration.medium.name}. Calibrate the cone in {medium}."
        )
    angle, b, covariance = calibration.cone
    mean = {"half_angle": angle, "b": b}
    robot, moved = tolerances(recordings).get("robot_scale"), calibration.stated.get("robot_scale")
    if robot and moved is not None:
        # The robot of both fits is one, so that its scale's error does not average out.
        of_cone = moved[:, [list(calibration.values).index(name) for name in mean]].sum(axis=0)
        across = robot.sigma * of_cone[:, None]
        covariance = np.block([[covariance, across], [across.T, robot.sigma**2 * np.eye(1)]])
        mean["robot_scale"] = robot.mean
    return JointPrior(mean, covariance)
