"""What a rig states only to a tolerance: free parameters of every fit, with the rig's prior.

Residuals do not show that the scale of robot or microscope is off, since half-angle and apex
follow it. So the covariance of a calibration must contain what the maker of the rig knows.
"""

from collections.abc import Iterable, Sequence
from typing import NamedTuple

from eyespot.calibration.recorded_trial import RecordedTrial
from eyespot.calibration.spots.cone_trials import Prior
from eyespot.estimator.distance.consistency import NOTED_SIGMAS

OF_ROBOT = ("robot_scale", "clock_offset")
"""Tolerances of the robot."""
TOLERANCES = ("scale", "eye_radius", "inverse_working_distance", *OF_ROBOT)
"""The keys of `tolerances`."""
_UNTOUCHED = 0.9
"""Standard error over a prior's above which the data say nothing: they would weigh a quarter."""


def tolerances(recordings: Sequence[RecordedTrial]) -> dict[str, Prior]:
    """Priors of parameters that are known to a tolerance: scales, eye radius, pinhole, clocks.

    By the names of `cone_fit.PARAMETERS`. Of several rigs the widest tolerance counts; planes have
    no radius.
    """
    first = recordings[0]
    rigs, view = [one.recording.rig for one in recordings], first.microscope
    stated = [rig.stated for rig in rigs]
    spheres = any(one.trial.kind == "eyeball" for one in recordings)
    found = {
        "scale": (view.scale_mm_px, view.scale_mm_px * max(s.scale_sigma for s in stated)),
        "eye_radius": (
            view.eye_radius_mm,
            spheres * max(s.eye_radius_sigma_mm for s in stated),
        ),
        "inverse_working_distance": (
            view.inverse_working_distance,
            max(s.inverse_working_distance_sigma for s in stated),
        ),
        "robot_scale": (1.0, max(rig.robot.scale_sigma for rig in rigs)),
        "clock_offset": (0.0, max(rig.robot.clock_sigma_s for rig in rigs)),
    }
    return {name: Prior(*prior) for name, prior in found.items() if prior[1] > 0}


def stated_core(recording: RecordedTrial) -> Prior | None:
    """The core's radius, mm, as the rig states it; None if it does not."""
    tip = recording.recording.rig.instrument
    if tip.core_radius_mm is None:
        return None
    return Prior(tip.core_radius_mm, tip.core_radius_mm * tip.core_radius_sigma)


def microscope_of(recordings: Sequence[RecordedTrial]) -> str:
    """The name of the microscope that all recordings share; empty if none is stated."""
    names = {one.recording.rig.microscope.id for one in recordings}
    return names.pop() if len(names) == 1 else ""


class PriorOutcome(NamedTuple):
    """A parameter with its prior, and what the fit found."""

    name: str
    prior: Prior
    value: float
    sigma: float


def said_of_priors(parameters: Iterable[PriorOutcome]) -> list[str]:
    """Sentences for the report: which parameters rest on their prior, and which left it."""
    every = list(parameters)
    alone = [one.name for one in every if one.sigma > _UNTOUCHED * one.prior.sigma]
    notes = [
        f"{one.name} is {one.value:.5g}, {(one.value - one.prior.mean) / one.prior.sigma:+.1f} σ "
        f"from the {one.prior.mean:.5g} ± {one.prior.sigma:.2g} that was stated."
        for one in every
        if abs(one.value - one.prior.mean) > NOTED_SIGMAS * one.prior.sigma
    ]
    return [f"The data say nothing about what was stated of {', '.join(alone)}."] * bool(
        alone
    ) + notes
