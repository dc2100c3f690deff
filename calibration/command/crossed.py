"""Recordings of one beam, fitted apart: do they agree, and does each read the distances of others?

A covariance is valid only if the model is. Two recordings of the same beam that are fitted apart
show errors of the model that no covariance contains (mrcal's cross-validation). What both share,
such as the scales of microscope and robot, moves both fits alike; so it is held as stated in the
fits of cones apart, and in fits of lenses the shared part of the errors is left out (`apart`).
"""

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from jaxtyping import Float
from matplotlib.figure import Figure

from eyespot import optics
from eyespot.calibration.command.apart import CHANCE, compared
from eyespot.calibration.command.fit_verdict import Fitted
from eyespot.calibration.recorded_trial import RecordedTrial
from eyespot.estimator import Ranger
from eyespot.estimator.recording import Recording
from eyespot.formats.calibration import BEAM, Calibration
from eyespot.formats.report_page import PALETTE
from eyespot.formats.spot import Spot


class Read(NamedTuple):
    """Distances of one recording by the calibration of another, mm, (n,).

    Attributes:
        robot: distances by the robot and the recording's own first distance.
        off: what was read less them; NaN where nothing was.
        sigma: standard deviation of that difference.
    """

    robot: Float[np.ndarray, "n"]
    off: Float[np.ndarray, "n"]
    sigma: Float[np.ndarray, "n"]

    @property
    def summary(self) -> tuple[float, float, float]:
        """Root mean square, mean, and root mean square in standard deviations."""
        off, deviations = self.off, self.off / self.sigma
        return (
            float(np.sqrt(np.nanmean(off**2))),
            float(np.nanmean(off)),
            float(np.sqrt(np.nanmean(deviations**2))),
        )


class Crossed(NamedTuple):
    """Recordings that were fitted apart.

    Attributes:
        parameters: a row for each recording and parameter: value, sigma, and the difference from
            what all recordings together say, in its standard deviations.
        distances: a row for each recording and each other one's calibration: root mean square and
            mean of the distances read less those of the robot, mm, and the root mean square over
            the standard deviations.
        read: what each of these rows summarises.
        chance: probability that recordings of one beam differ as much.
        foreign: the recording that the others disagree with, if they agree without it; or empty.
    """

    parameters: pd.DataFrame
    distances: pd.DataFrame
    read: list[Read]
    chance: float
    foreign: str = ""

    @property
    def agree(self) -> bool:
        """Whether chance explains the differences."""
        return self.chance >= CHANCE

    @property
    def verdict(self) -> str:
        """Whether the recordings agree, in a sentence."""
        count = self.parameters["recording"].nunique()
        who = "the two recordings" if count == 2 else f"the {count} recordings"
        if self.agree:
            return f"{who} agree: p = {self.chance:.2g}"
        worst = self.parameters.iloc[int(np.argmax(self.parameters["sigmas"].abs()))]
        said = (
            f"{who} disagree: p = {self.chance:.1g}; {worst['parameter']} of {worst['recording']} "
            f"is {abs(worst['sigmas']):.1f} σ from the others"
        )
        if self.foreign:
            return f"{said}. Without {self.foreign} the others agree: leave it out"
        return f"{said}. Either the beams differ, or a rig is not as its file says"

    def figure(self) -> Figure:
        """Distances read by the other recordings' calibrations less those of the robot."""
        figure = Figure(figsize=(10.0, 3.2), layout="constrained")
        axes = figure.subplots()
        rows = zip(self.distances.itertuples(), self.read, strict=True)
        for number, (row, one) in enumerate(rows):
            label = f"{row.recording} by {row.calibration}"
            colour = PALETTE[number % len(PALETTE)]
            axes.plot(one.robot, 1e3 * one.off, "o-", ms=3, lw=0.8, color=colour)
            axes.lines[-1].set_label(label)
        axes.axhline(0.0, color="#999999", lw=0.8)
        axes.set(xlabel="distance by the robot (mm)", ylabel="read less robot (µm)")
        axes.legend(fontsize=7)
        return figure


def crossed(apart: Sequence[Fitted], read: Callable[[Fitted, Fitted], Read]) -> Crossed | None:
    """Compare fits of one recording each; None if one of them is not determined.

    Args:
        read: distances of the first fit's recording, by the second one's calibration.
    """
    names = [one.recordings[0].name for one in apart]
    if len(set(names)) < len(names):  # folders of images are often called alike
        names = [f"{name} ({number})" for number, name in enumerate(names, 1)]
    if not all(one.converged and not one.undetermined for one in apart):
        return None
    known = compared(apart)
    mean, rows = known.mean, []
    for one, (name, value) in enumerate(zip(names, known.values, strict=True)):
        sigma = np.sqrt(np.diag(known.covariances[one]))
        spread = np.sqrt(np.maximum(np.diag(known.of_difference(one)), 0.0))
        sigmas = np.divide(value - mean, spread, out=np.zeros_like(mean), where=spread > 0)
        rows += [(name, *row) for row in zip(known.names, value, sigma, sigmas, strict=True)]
    foreign = ""
    if known.chance < CHANCE and len(apart) > 2:
        without = [known.without(one).chance for one in range(len(apart))]
        best = int(np.argmax(without))
        foreign = names[best] if without[best] >= CHANCE else ""
    pairs = [(at, by) for at in range(len(apart)) for by in range(len(apart)) if at != by]
    found = [read(apart[at], apart[by]) for at, by in pairs]
    table = [
        (names[at], names[by], *one.summary) for (at, by), one in zip(pairs, found, strict=True)
    ]
    return Crossed(
        parameters=pd.DataFrame(
            rows, columns=["recording", "parameter", "value", "sigma", "sigmas"]
        ),
        distances=pd.DataFrame(
            table, columns=["recording", "calibration", "rms_mm", "mean_mm", "rms_sigmas"]
        ),
        read=found,
        chance=known.chance,
        foreign=foreign,
    )


_SHARED = (
    "microscope.scale_sigma",
    "microscope.pinhole_height_sigma_mm",
    "wall.radius_sigma_mm",
    "robot.scale_sigma",
)
"""Keys of the rig file by which the errors of recordings hang together."""


def as_stated(one: RecordedTrial) -> RecordedTrial:
    """A recording whose rig is exact in what it shares with the others."""
    own = one.recording
    rig = own.rig.changed(dict.fromkeys(_SHARED, 0.0))
    return one._replace(recording=Recording(own.source, poses=own.poses(), rig=rig))


def _first_distance(one: RecordedTrial, own: Fitted) -> tuple[float, float]:
    """Distance of a recording's first frame and its standard deviation, mm, as its fit has it."""
    found = {name: (value, sigma) for name, value, sigma, _ in own.others}
    stated = one.trial.touch.mean, one.trial.touch.sigma
    return found.get(f"touch of {one.name}", found.get("touch", stated))


def read_by_cone(own: Fitted, other: Fitted) -> Read:
    """Distances of a recording's spots by another one's cone, along the recording's own beam."""
    (one,) = own.recordings
    trial, view = one.sharp_trial, one.microscope
    names = ("half_angle", "b")
    angle, b = (other.values[name] for name in names)
    beam = trial.axis + one.across.T @ [own.values.get(name, 0.0) for name in BEAM]
    eye = optics.ConeView(
        k=np.array([1.0 / math.tan(angle)]),
        b=np.array([b]),
        scale=view.scale_mm_px,
        eye_radius=view.eye_radius_mm,
        inverse_working_distance=view.inverse_working_distance,
        normal=view.plane_normal,
    )
    ellipses: Any = trial.ellipses
    axes_px = np.asarray(ellipses.semi_major), np.asarray(ellipses.semi_minor)
    found, _ = eye.distance_of(
        at_px=np.asarray(ellipses.centre) - trial.principal_point,
        size_px=np.sqrt(axes_px[0] * axes_px[1]),
        axis=np.tile(beam / np.linalg.norm(beam), (len(trial.readings), 1)),
        by_area=True,
    )
    touch, touch_sigma = _first_distance(one, own)
    # d = k R + b to first order, and a relative error of k is one of the angle's sine and cosine.
    slopes = np.stack([-2.0 * (found - b) / math.sin(2.0 * angle), np.ones_like(found)], axis=1)
    at = [list(other.values).index(name) for name in names]
    variance = np.einsum("ni,ij,nj->n", slopes, other.covariance[np.ix_(at, at)], slopes)
    robot = touch + trial.readings
    return Read(robot, found - robot, np.sqrt(variance + touch_sigma**2))


def read_by_lens(own: Fitted, calibration: Calibration) -> Read:
    """Distances of a recording's outlines by another one's lens."""
    (one,) = own.recordings
    trial, ranger = one.trial, Ranger(calibration, one.microscope)
    spots = {record.frame: record.result for record in one.records}
    found = {}
    for frame in one.recording.source:
        if isinstance(spot := spots.get(frame.index), Spot):
            ranged = ranger.distance(spot, axis=trial.axis, frame=frame.image)
            found[frame.index] = ranged.distance_mm, ranged.sigma_mm
    distance, sigma = np.array([found[number] for number in spots]).T
    touch, touch_sigma = _first_distance(one, own)
    robot = touch + trial.readings
    return Read(robot, distance - robot, np.hypot(sigma, touch_sigma))
