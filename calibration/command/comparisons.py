"""What a fit found, against what the rig file states of it."""

import math
from collections.abc import Iterable, Iterator, Sequence

import numpy as np

from eyespot.calibration.pixels.fit import ImageFit
from eyespot.calibration.recorded_trial import FREE_TOUCH, RecordedTrial
from eyespot.calibration.spots.cone_fit import ConeFit
from eyespot.calibration.tolerances import TOLERANCES, PriorOutcome
from eyespot.estimator.distance.consistency import Compared, against_prior, contact
from eyespot.estimator.distance.withdrawal import BORESIGHT_SIGMA

_OF_TOUCH = (
    "The recording does not begin where the rig file says (robot.touch), or the tool's axis or the "
    "travel has the wrong sense"
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
            found = against_prior("tolerance", one.name, *numbers, cause=_OF_TOLERANCE)
            yield from [found] if found else []


def cone_against_rig(fit: ConeFit, recordings: Sequence[RecordedTrial]) -> Iterator[Compared]:
    """A cone's radius at the tip, first distances and directions against the rig."""
    names = [*fit.free]
    angle, b = fit.values["half_angle"], fit.values["b"]
    at = [names.index(name) if name in names else -1 for name in ("half_angle", "b")]
    slopes = np.array([-b / math.cos(angle) ** 2, -math.tan(angle)])
    known = fit.covariance[np.ix_(at, at)]
    determined = min(at) >= 0 and np.isfinite(known).all()
    at_tip = math.sqrt(slopes @ known @ slopes) if determined else math.inf
    for number, one in enumerate(recordings):
        own = one.recording.rig.instrument
        if one.ghost is not None:
            yield Compared("ghost", one.ghost.sigmas, f"{one.name}: {one.ghost.said}")
        if one.trial.touch == FREE_TOUCH:  # b then rests on the core
            continue
        yield contact(
            -b * math.tan(angle),
            at_tip,
            core_mm=own.core_radius_mm,
            core_sigma=own.core_radius_sigma,
            fibre_mm=one.fibre_radius_mm,
            where=one.name,
        )
        yield from _of_touch(one, fit.touch[number], fit.touch_error[number])
        sigmas = np.sqrt(np.diag(fit.boresight_covariance[number]))
        for aside, sigma in zip(fit.boresight[number], sigmas, strict=True):
            yield from _of_beam(one, aside, sigma)


def pixels_against_rig(fit: ImageFit, one: RecordedTrial) -> Iterator[Compared]:
    """First distance and direction of a beam that was fitted to pixels, against the rig; ghosts."""
    if fit.ghost is not None and fit.ghost.is_found:
        yield Compared("ghost", fit.ghost.sigmas, f"{one.name}: {fit.ghost.said}")
    for name, (value, sigma) in fit.parameters.items():
        if name == "touch":
            yield from _of_touch(one, value, sigma)
        elif name in ("boresight", "boresight_sideways"):
            yield from _of_beam(one, value, sigma)


def _of_touch(one: RecordedTrial, value: float, sigma: float) -> Iterator[Compared]:
    """The distance in the first frame, mm, by the light and as stated."""
    name = f"{one.name}: the distance in the first frame (mm)"
    found = against_prior("touch", name, value, sigma, *one.trial.touch, cause=_OF_TOUCH)
    yield from [found] if found else []


def _of_beam(one: RecordedTrial, angle: float, sigma: float) -> Iterator[Compared]:
    """An angle of the beam from the tool's axis, by the spots' way in the image."""
    name = f"{one.name}: an angle of the beam from the tool's axis (rad)"
    found = against_prior("beam", name, angle, sigma, 0.0, BORESIGHT_SIGMA, cause=_OF_BEAM)
    yield from [found] if found else []
