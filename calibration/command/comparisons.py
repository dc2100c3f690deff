"""What a fit found, against what the rig file states of it."""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence

import numpy as np
from jaxtyping import Float

from eyespot.calibration.pixels.data import CONE
from eyespot.calibration.pixels.fit_result import ImageFit
from eyespot.calibration.recorded_trial import FREE_TOUCH, RecordedTrial
from eyespot.calibration.spots.cone_fit import ConeFit
from eyespot.calibration.spots.cone_trials import LEAN_SIGMA
from eyespot.calibration.tolerances import TOLERANCES, PriorOutcome
from eyespot.estimator.distance.consistency import Compared, against_prior, contact
from eyespot.estimator.distance.withdrawal import BORESIGHT_SIGMA

_OF_TOUCH = (
    "The recording does not begin where the rig file says (robot.touch), or the tool's axis or the "
    "travel has the wrong sense"
)
_OF_FRAME = (
    "The robot's frame is not as the rig file says: correct robot.eye_from_robot, the sign or the "
    "order of its axes (robot.columns), or robot.tool_axis; or the wall's kind or the microscope's "
    "principal_point_px is another, or the eye turned"
)
_OF_BEAM = (
    "The tool's axis (robot.tool_axis), its motion and the way of the spot in the image do not "
    "belong together: correct robot.tool_axis, robot.columns or robot.eye_from_robot"
)

_OF_TOLERANCE = (
    "It is not as stated, or another number that changes the spots likewise is not: correct it, or "
    "state a larger sigma"
)


def priors_against_images(outcomes: Iterable[PriorOutcome]) -> Iterator[Compared]:
    """What the rig states to a tolerance, against what the fit found."""
    for one in outcomes:
        if one.name in TOLERANCES:
            numbers = one.value, one.sigma, *one.prior
            yield against_prior("tolerance", one.name, *numbers, cause=_OF_TOLERANCE)


def cone_against_rig(fit: ConeFit, recordings: Sequence[RecordedTrial]) -> Iterator[Compared]:
    """A cone's radius at the tip, first distances and directions against the rig."""
    cone = {name: fit.values[name] for name in CONE}
    for number, one in enumerate(recordings):
        if one.ghost is not None:
            yield Compared("ghost", one.ghost.sigmas, f"{one.name}: {one.ghost.said}")
        for angle, sigma in zip(fit.lean[number], fit.lean_error[number], strict=True):
            yield _of_frame(one, angle, sigma)
        if one.trial.touch == FREE_TOUCH:  # b then rests on the core
            continue
        yield _of_contact(one, cone, [*fit.free], fit.covariance)
        yield _of_touch(one, fit.touch[number], fit.touch_error[number])
        sigmas = np.sqrt(np.diag(fit.boresight_covariance[number]))
        for aside, sigma in zip(fit.boresight[number], sigmas, strict=True):
            yield _of_beam(one, aside, sigma)


def pixels_against_rig(fit: ImageFit, one: RecordedTrial) -> Iterator[Compared]:
    """As `cone_against_rig`, of a beam that was fitted to pixels; a lens has no such radius."""
    if fit.ghost is not None and fit.ghost.is_found:
        yield Compared("ghost", fit.ghost.sigmas, f"{one.name}: {fit.ghost.said}")
    if one.trial.touch != FREE_TOUCH and fit.values.keys() >= {*CONE}:
        values = {**fit.values, **{name: value for name, (value, _) in fit.parameters.items()}}
        yield _of_contact(one, values, [*fit.parameters], fit.covariance)
    for name, found in fit.parameters.items():
        considered = fit.considered[name]
        if name == "touch":
            yield _of_touch(one, *found, considered)
        elif name in ("lean", "lean_sideways"):
            yield _of_frame(one, *found, considered)
        elif name in ("boresight", "boresight_sideways"):
            yield _of_beam(one, *found, considered)


def _of_contact(
    one: RecordedTrial,
    cone: Mapping[str, float],
    free: Sequence[str],
    covariance: Float[np.ndarray, "p p"],
) -> Compared:
    """The radius of a cone's light at the tip, against the core's or the fibre's."""
    angle, b = (cone[name] for name in CONE)
    at = [free.index(name) if name in free else -1 for name in CONE]
    slopes = np.array([-b / math.cos(angle) ** 2, -math.tan(angle)])
    known = covariance[np.ix_(at, at)]
    determined = min(at) >= 0 and np.isfinite(known).all()
    own = one.recording.rig.instrument
    return contact(
        -b * math.tan(angle),
        math.sqrt(slopes @ known @ slopes) if determined else math.inf,
        core_mm=own.core_radius_mm,
        core_sigma=own.core_radius_sigma,
        fibre_mm=one.fibre_radius_mm,
        where=one.name,
    )


def _of_touch(one: RecordedTrial, value: float, sigma: float, considered: float = 0.0) -> Compared:
    """The distance in the first frame, mm, by the light and as stated."""
    name = f"{one.name}: the distance in the first frame (mm)"
    numbers = value, sigma, *one.trial.touch
    return against_prior("touch", name, *numbers, cause=_OF_TOUCH, considered=considered)


def _of_frame(one: RecordedTrial, angle: float, sigma: float, considered: float = 0.0) -> Compared:
    """A rotation of the robot's directions against the eye, by the spots' outlines."""
    name = f"{one.name}: a rotation of the robot's directions against the eye (rad)"
    numbers = angle, sigma, 0.0, LEAN_SIGMA
    return against_prior("frame", name, *numbers, cause=_OF_FRAME, considered=considered)


def _of_beam(one: RecordedTrial, angle: float, sigma: float, considered: float = 0.0) -> Compared:
    """An angle of the beam from the tool's axis, by the spots' way in the image."""
    name = f"{one.name}: an angle of the beam from the tool's axis (rad)"
    numbers = angle, sigma, 0.0, BORESIGHT_SIGMA
    return against_prior("beam", name, *numbers, cause=_OF_BEAM, considered=considered)
