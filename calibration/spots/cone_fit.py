"""Fit of the exact geometry to measured ellipses, with nuisances per trial (see `cone_trials`)."""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from eyespot import optics
from eyespot.calibration.least_squares import (
    chance_alike,
    covariance_and_lost,
    excess_variance,
    propagated,
    slow_waves,
)
from eyespot.calibration.spots.cone_problem import (
    PARAMETERS,
    ConeProblem,
    rows_of,
    with_both_sides_of_the_clock,
)
from eyespot.calibration.spots.cone_trials import (
    HELD,
    LEAN_SIGMA,
    NUISANCES,
    ConeTrial,
    JointPrior,
    Prior,
    prior_terms,
)
from eyespot.estimator.distance.withdrawal import BORESIGHT_SIGMA
from eyespot.formats.inputs import InputError

_SIZES = {"inverse_working_distance": 0.01, "tilt_x": 0.1, "tilt_y": 0.1, "clock_offset": 0.1}
"""Scales of parameters that may be zero; the scale of the others is their value."""
MISMATCHES = ("position right", "position down", "size", "elongation right", "elongation oblique")
"""The components of `ConeFit.residuals` in words."""
HALVES: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "near and far": lambda readings: readings > np.median(readings),
    "even and odd": lambda readings: np.arange(readings.size) % 2 == 1,
}
"""Which spots of a trial are the second half, by the name of both."""
_HAS_PRIOR = np.array([name not in ("u", "v") for name in NUISANCES], float)


class ConeFit(NamedTuple):
    """The parameters, with the covariance of the fitted ones.

    Attributes:
        values: all parameters by name, in the units of `PARAMETERS`.
        free: names of the fitted parameters, in the covariance's order.
        covariance: of the fitted parameters, from the ellipses' covariances times `growth`.
        growth: factor on the ellipses' covariances that their residuals demand, by chi squared or
            by slow waves; priors stay as they are.
        touch: distance at reading 0 per trial, mm.
        touch_error: its standard error, mm; infinite if the data do not determine it.
        lean: rotation of the robot against the eye per trial, along the two vectors of
            `optics.perpendicular_frame`, rad.
        lean_error: its standard errors, rad; infinite if the data do not determine it.
        boresight: angle of the beam from the tool's axis per trial, along the same vectors, rad.
        boresight_covariance: covariance of each; infinite if the data do not determine it.
        shake_px: standard deviation of each trial's shake along each side of the image, from one
            frame to the next, px; 0 where the spots' own errors explain their places.
        spot: (x, y) of the wall's point that the beam meets at reading 0 per trial, mm.
        spot_covariance: covariance of each spot; infinite if the data do not determine it.
        residuals: `optics.ellipse_mismatch` with variance 1, n x 5 per trial, along the image.
        chi_squared: sum of squared residuals over their sigma, priors included.
        degrees_of_freedom: number of data and priors minus number of parameters.
        undetermined: parameters that neither data nor priors determine, in words; may be empty.
        stated: by prior, how far each of its standard deviations moves the fitted parameters,
            (m, p): a row for a parameter, one per trial for `touch`. The squares' sum is the
            prior's part of the variances.
        halves: by the name of two halves of the spots, the probability that one cone's differ as
            much.
    """

    values: dict[str, float]
    free: tuple[str, ...]
    covariance: Float[np.ndarray, "p p"]
    growth: float
    touch: Float[np.ndarray, "trials"]
    touch_error: Float[np.ndarray, "trials"]
    lean: Float[np.ndarray, "trials 2"]
    lean_error: Float[np.ndarray, "trials 2"]
    boresight: Float[np.ndarray, "trials 2"]
    boresight_covariance: Float[np.ndarray, "trials 2 2"]
    shake_px: Float[np.ndarray, "trials"]
    spot: Float[np.ndarray, "trials 2"]
    spot_covariance: Float[np.ndarray, "trials 2 2"]
    residuals: tuple[Float[np.ndarray, "n 5"], ...]
    chi_squared: float
    degrees_of_freedom: int
    undetermined: tuple[str, ...]
    stated: dict[str, Float[np.ndarray, "m p"]]
    halves: dict[str, float]
    converged: bool

    @property
    def eccentricity(self) -> Float[np.ndarray, "trials"]:
        """c of each trial's spot, mm."""
        return np.hypot(*self.spot.T)

    @property
    def eccentricity_error(self) -> Float[np.ndarray, "trials"]:
        """Standard error of c, mm."""
        outward = self.spot / np.maximum(self.eccentricity, 1e-12)[:, None]
        known = np.isfinite(self.spot_covariance)
        variance = np.einsum(
            "ti,tij,tj->t", outward, np.where(known, self.spot_covariance, 0.0), outward
        )
        return np.sqrt(np.where(known.all(axis=(1, 2)), variance, np.inf))


def fit_cone(
    trials: Sequence[ConeTrial],
    microscope: optics.Microscope,
    *,
    start: Mapping[str, float],
    free: Sequence[str] = ("half_angle", "b"),
    priors: Mapping[str, Prior] | None = None,
    joint_prior: JointPrior | None = None,
    size_sigmas: Sequence[float] | None = None,
    outline_sigmas: Sequence[float] | None = None,
) -> ConeFit:
    """Fit the exact contour to the ellipses of all trials at once.

    Args:
        trials: planes and spheres together.
        microscope: ideal pinhole. `start` may replace its scale, eye radius and working distance;
            each trial replaces its principal point.
        start: start values of free parameters and values of the others: `half_angle` and `b`;
            optionally those that replace the microscope's, and the plane's tilt (default 0).
        free: names of `PARAMETERS` to fit.
        joint_prior: of other free parameters, such as a cone that was calibrated before.
        size_sigmas: standard deviation of the part by which the microscope's model misses the size
            of each trial's spots, relative; None if it is a pinhole.
        outline_sigmas: the same for the outline of each frame's spot.

    Raises:
        InputError: an unknown name, or no trial.
    """
    unknown = [name for name in (*free, *(priors or {})) if name not in PARAMETERS]
    if unknown or not trials:
        raise InputError(
            f"fit_cone needs one trial or more and names of {', '.join(PARAMETERS)}; got "
            f"{len(trials)} trials and {', '.join(unknown) or 'no unknown name'}."
        )
    known = {
        "scale": float(microscope.scale),
        "eye_radius": -float(microscope.pole_height),
        "inverse_working_distance": float(microscope.inverse_working_distance),
    }
    zero = dict.fromkeys(("tilt_x", "tilt_y", "clock_offset"), 0.0)
    fixed = known | zero | {"robot_scale": 1.0} | dict(start)
    # With these scales, the damping affects all parameters equally.
    sizes = np.array([_SIZES.get(name) or abs(fixed[name]) for name in free])
    own = {name: prior for name, prior in (priors or {}).items() if name in free}
    prior_means, prior_weights = prior_terms(PARAMETERS, own, joint_prior)
    nothing = [0.0] * len(trials)
    of_kinds = [
        [number for number, trial in enumerate(trials) if trial.kind == kind]
        for kind in sorted({trial.kind for trial in trials})
    ]
    priors_held = int(np.sum(prior_weights.any(axis=1)))
    frames = sum(trial.readings.size for trial in trials)
    problem = ConeProblem(
        microscope=microscope,
        of_kinds=of_kinds,
        missed=(size_sigmas or nothing, outline_sigmas or nothing),
        fixed=fixed,
        steps=np.array([[name == own for own in free] for name in PARAMETERS]) * sizes,
        prior_means=prior_means,
        prior_weights=prior_weights,
        count=5 * frames + priors_held + HELD * len(trials),
    )
    groups = problem.groups(trials)
    rows = rows_of(groups, of_kinds, trials)
    at_end = problem.solved(groups)
    off = _along_image(np.asarray(at_end.solution.residuals), rows, trials)
    shakes = [shake_px(trial, own[:, :2]) for trial, own in zip(trials, off, strict=True)]
    if any(shakes):
        seen = [trial.shaken(by) for trial, by in zip(trials, shakes, strict=True)]
        groups = problem.groups(seen)
        at_end = problem.solved(groups, at_end.solution.parameters)
    if "clock_offset" in own and not problem.explained(at_end):
        # Where a robot sets off, chi squared bends at each frame's moment, and has several minima.
        clock = own["clock_offset"]
        others = [
            problem.solved(groups, problem.with_clock(at_end, clock.mean + side * clock.sigma))
            for side in (-1.0, 1.0)
        ]
        at_end = min((at_end, *others), key=lambda one: one.chi_squared)
    solution, spot, spot_slopes = at_end
    moving = problem.moving(at_end)
    jacobian = np.asarray(solution.jacobian)[:, moving]
    information = jacobian.T @ jacobian
    found = np.asarray(solution.parameters)[moving]
    moved = sizes * found[: len(free)]
    values = fixed | {
        name: fixed[name] + float(step) for name, step in zip(free, moved, strict=True)
    }
    left = np.asarray(solution.residuals)
    residuals = _along_image(left, rows, trials)
    chi_squared = at_end.chi_squared
    degrees = problem.count - found.size
    kinds = dict(zip(MISMATCHES, np.concatenate(residuals).T, strict=True))
    growth = max(
        1.0,
        excess_variance(chi_squared / degrees, degrees),
        *(power for _, power, _, structured in slow_waves(kinds) if structured),
    )
    of_priors = np.diag(np.concatenate([np.zeros(len(free)), *[_HAS_PRIOR] * len(trials)]))
    of_free = prior_weights[:, [PARAMETERS.index(name) for name in free]] * sizes
    of_priors[: len(free), : len(free)] = of_free.T @ of_free
    cone = [list(free).index(name) for name in ("half_angle", "b") if name in free]
    halves = {}
    for name, in_half in HALVES.items():
        chosen = [own[in_half(trial.readings)] for own, trial in zip(rows, trials, strict=True)]
        halves[name] = chance_alike(
            left,
            jacobian,
            rows=np.concatenate(chosen, axis=None),
            columns=cone,
            degrees_of_freedom=degrees,
        )
    numbers = [number for own in of_kinds for number in own]
    nuisances = [f"{name} of trial {number + 1}" for number in numbers for name in NUISANCES]
    covariance, undetermined = covariance_and_lost(
        (information - of_priors) / growth + of_priors,
        (*free, *nuisances),
        [*(values[name] for name in free), *found[len(free) :]],
    )
    if "clock_offset" in own:
        widest = own["clock_offset"].sigma
        covariance = with_both_sides_of_the_clock(problem, at_end, groups, covariance, widest)
    errors = np.sqrt(np.diag(covariance))
    in_order = np.argsort(numbers)
    shape = len(trials), len(NUISANCES)
    deviations, known_to = (x[len(free) :].reshape(shape)[in_order] for x in (found, errors))
    means, sigmas = np.array([trial.touch for trial in trials]).T
    beams = [slice(at + 5, at + 7) for at in len(free) + len(NUISANCES) * in_order]
    shared = slice(len(free))
    # A prior's mean moves the minimum by the covariance over its variance.
    at_touch = len(free) + len(NUISANCES) * np.arange(len(trials))
    stated = {
        name: covariance[[free.index(name)], shared] * sizes[free.index(name)] / prior.sigma
        for name, prior in own.items()
    } | {"touch": covariance[at_touch, shared]}
    slopes = np.asarray(spot_slopes)[in_order][..., moving]
    return ConeFit(
        values=values,
        free=tuple(free),
        covariance=covariance[shared, shared] * np.outer(sizes, sizes),
        growth=growth,
        touch=means + sigmas * deviations[:, 0],
        touch_error=sigmas * known_to[:, 0],
        lean=LEAN_SIGMA * deviations[:, 3:5],
        lean_error=LEAN_SIGMA * known_to[:, 3:5],
        boresight=BORESIGHT_SIGMA * deviations[:, 5:7],
        boresight_covariance=BORESIGHT_SIGMA**2 * np.array([covariance[at, at] for at in beams]),
        shake_px=np.array(shakes),
        spot=np.asarray(spot)[in_order],
        spot_covariance=np.stack([propagated(by, covariance) for by in slopes]),
        residuals=residuals,
        chi_squared=chi_squared,
        degrees_of_freedom=degrees,
        undetermined=undetermined,
        stated={name: moves * sizes for name, moves in stated.items()},
        halves=halves,
        converged=at_end.settled,
    )


def _along_image(
    left: Float[np.ndarray, "m"], rows: Sequence[np.ndarray], trials: Sequence[ConeTrial]
) -> tuple[Float[np.ndarray, "n 5"], ...]:
    """Residuals of each trial's frames along the image.

    Noise makes every measured circle an ellipse, and along its own axis that ellipse is always too
    long, so that residuals there have one sign and look as if they had structure.
    """
    found = []
    for trial, own in zip(trials, rows, strict=True):
        u, v, size, long, oblique = left[own].T
        turn = np.exp(1j * np.asarray(trial.ellipses.angle))
        place, shape = turn * (u + 1j * v), turn**2 * (long + 1j * oblique)
        found.append(np.stack([place.real, place.imag, size, shape.real, shape.imag], axis=1))
    return tuple(found)


def shake_px(trial: ConeTrial, places: Float[np.ndarray, "n 2"]) -> float:
    """Standard deviation of the view's shake along each side of the image, px.

    A shake moves each spot anew, while all that a model misses changes slowly from frame to frame,
    so second differences see the shake alone. Their median does not follow single outliers.

    Args:
        places: residuals of the spots' places over their standard deviations, along the image.

    Returns:
        0 where the spots' own errors explain the places.
    """
    bends = np.sum(np.square(np.diff(places, 2, axis=0)), axis=1)
    # Each side has 6 variances; the median of a sum of two squares is 2 ln 2 of its variance.
    power = float(np.median(bends)) / (12.0 * math.log(2.0)) if bends.size else 0.0
    # Neighbours share frames and a median uses half of what it sees: one degree for two bends.
    grown = excess_variance(power, len(bends) / 2)
    variance = np.trace(trial.covariances[:, :2, :2], axis1=1, axis2=2) / 2
    return math.sqrt((grown - 1.0) / float(np.mean(1.0 / variance)))
