"""Recordings of one beam, fitted apart: do they agree, and does each read the distances of others?

A covariance is valid only if the model is. Two recordings of the same beam that are fitted apart
show errors of the model that no covariance contains (mrcal's cross-validation). What both share,
such as the scales of microscope and robot, moves both fits alike; so it is held as stated in the
fits apart, and says nothing for their agreement.
"""

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from jaxtyping import Float
from matplotlib.figure import Figure
from scipy import stats

from eyespot.calibration.command.verdict import Fitted
from eyespot.calibration.recorded_trial import RecordedTrial
from eyespot.estimator.distance.consistency import CONTRADICTION_SIGMAS
from eyespot.estimator.distance.tilted_cone import ConeView, distance_of
from eyespot.estimator.recording import Recording
from eyespot.formats.calibration import BEAM
from eyespot.formats.page import PALETTE

_SHARED = (
    "microscope.scale_sigma",
    "microscope.pinhole_height_sigma_mm",
    "wall.radius_sigma_mm",
    "robot.scale_sigma",
)
"""Keys of the rig file by which the errors of recordings hang together."""
_CHANCE = 2.0 * stats.norm.sf(CONTRADICTION_SIGMAS)
"""Probability below which recordings disagree, as of any other comparison."""
_COMPARED = ("half_angle", "b")


class Crossed(NamedTuple):
    """Recordings that were fitted apart.

    Attributes:
        parameters: a row for each recording and parameter: value, sigma, and the difference from
            what all recordings together say, in its standard deviations.
        distances: a row for each recording and each other one's calibration: root mean square and
            mean of the distances read less those of the robot, mm, and the root mean square over
            the standard deviations.
        read: of each of these rows, the robot's distances and what was read less them, mm.
        chance: probability that recordings of one beam differ as much.
        foreign: the recording that the others disagree with, if they agree without it; or empty.
    """

    parameters: pd.DataFrame
    distances: pd.DataFrame
    read: list[tuple[Float[np.ndarray, "n"], Float[np.ndarray, "n"]]]
    chance: float
    foreign: str = ""

    @property
    def agree(self) -> bool:
        """Whether chance explains the differences."""
        return self.chance >= _CHANCE

    @property
    def verdict(self) -> str:
        """Whether the recordings agree, in a sentence."""
        count = len(self.parameters) // len(_COMPARED)
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
        for number, (row, (robot, off)) in enumerate(rows):
            label = f"{row.recording} by {row.calibration}"
            axes.plot(robot, 1e3 * off, "o-", ms=3, lw=0.8, color=PALETTE[number % len(PALETTE)])
            axes.lines[-1].set_label(label)
        axes.axhline(0.0, color="#999999", lw=0.8)
        axes.set(xlabel="distance by the robot (mm)", ylabel="read less robot (µm)")
        axes.legend(fontsize=7)
        return figure


def crossed(
    recordings: Sequence[RecordedTrial], fit: Callable[[Sequence[RecordedTrial]], Fitted]
) -> Crossed | None:
    """Fit recordings of a cone apart and compare; None if one of them does not determine it.

    Args:
        fit: of recordings.
    """
    apart = [fit([_as_stated(one)]) for one in recordings]
    names = [one.name for one in recordings]
    if len(set(names)) < len(names):  # folders of images are often called alike
        names = [f"{name} ({number})" for number, name in enumerate(names, 1)]
    if not all(one.converged and not one.undetermined for one in apart):
        return None
    values = np.array([[one.values[name] for name in _COMPARED] for one in apart])
    covariances = np.array([_covariance(one) for one in apart])
    chance = _chance(values, covariances)
    mean, known = _mean(values, covariances)
    rows = []
    for name, value, covariance in zip(names, values, covariances, strict=True):
        # The mean contains the recording, so the difference has less variance than it.
        sigmas = (value - mean) / np.sqrt(np.maximum(np.diag(covariance - known), 1e-300))
        columns = zip(_COMPARED, value, np.sqrt(np.diag(covariance)), sigmas, strict=True)
        rows += [(name, *row) for row in columns]
    foreign = ""
    if chance < _CHANCE and len(recordings) > 2:
        without = [
            _chance(np.delete(values, k, axis=0), np.delete(covariances, k, axis=0))
            for k in range(len(recordings))
        ]
        best = int(np.argmax(without))
        foreign = names[best] if without[best] >= _CHANCE else ""
    pairs = [(at, by) for at in range(len(recordings)) for by in range(len(recordings)) if at != by]
    read = [_read(recordings[at], apart[at], apart[by]) for at, by in pairs]
    table = [
        (names[at], names[by], *_summary(off, sigma))
        for (at, by), (_, off, sigma) in zip(pairs, read, strict=True)
    ]
    return Crossed(
        parameters=pd.DataFrame(
            rows, columns=["recording", "parameter", "value", "sigma", "sigmas"]
        ),
        distances=pd.DataFrame(
            table, columns=["recording", "calibration", "rms_mm", "mean_mm", "rms_sigmas"]
        ),
        read=[(robot, off) for robot, off, _ in read],
        chance=chance,
        foreign=foreign,
    )


def _as_stated(one: RecordedTrial) -> RecordedTrial:
    """A recording whose rig is exact in what it shares with the others."""
    own = one.recording
    rig = own.rig.changed(dict.fromkeys(_SHARED, 0.0))
    return one._replace(recording=Recording(own.source, poses=own.poses(), rig=rig))


def _covariance(fitted: Fitted) -> Float[np.ndarray, "2 2"]:
    at = [list(fitted.values).index(name) for name in _COMPARED]
    return fitted.covariance[np.ix_(at, at)]


def _mean(
    values: Float[np.ndarray, "n p"], covariances: Float[np.ndarray, "n p p"]
) -> tuple[Float[np.ndarray, "p"], Float[np.ndarray, "p p"]]:
    """The weighted mean and its covariance."""
    information = np.linalg.inv(covariances)
    known = np.linalg.inv(information.sum(axis=0))
    return known @ np.einsum("kij,kj->i", information, values), known


def _chance(values: Float[np.ndarray, "n p"], covariances: Float[np.ndarray, "n p p"]) -> float:
    """Probability that values of one beam differ as much."""
    off = values - _mean(values, covariances)[0]
    chi_squared = np.einsum("ki,kij,kj->", off, np.linalg.inv(covariances), off)
    return float(stats.chi2.sf(chi_squared, (len(values) - 1) * values.shape[1]))


def _read(
    one: RecordedTrial, own: Fitted, other: Fitted
) -> tuple[Float[np.ndarray, "n"], Float[np.ndarray, "n"], Float[np.ndarray, "n"]]:
    """Distances by the robot; those read by another calibration less them; its deviations, mm."""
    trial, view = one.trial, one.microscope
    angle, b = (other.values[name] for name in _COMPARED)
    beam = trial.axis + one.across.T @ [own.values.get(name, 0.0) for name in BEAM]
    eye = ConeView(
        k=np.array([1.0 / math.tan(angle)]),
        b=np.array([b]),
        scale=view.scale_mm_px,
        eye_radius=view.eye_radius_mm,
        inverse_working_distance=view.inverse_working_distance,
        normal=view.plane_normal,
    )
    ellipses: Any = trial.ellipses
    axes_px = np.asarray(ellipses.semi_major), np.asarray(ellipses.semi_minor)
    found, _ = distance_of(
        eye,
        at_px=np.asarray(ellipses.centre) - trial.principal_point,
        size_px=np.sqrt(axes_px[0] * axes_px[1]),
        axis=np.tile(beam / np.linalg.norm(beam), (len(trial.readings), 1)),
        by_area=True,
    )
    touches = {name: (value, sigma) for name, value, sigma, _ in own.others}
    touch, touch_sigma = touches[f"touch of {one.name}"]
    # d = k R + b to first order, and a relative error of k is one of the angle's sine and cosine.
    slopes = np.stack([-2.0 * (found - b) / math.sin(2.0 * angle), np.ones_like(found)], axis=1)
    variance = np.einsum("ni,ij,nj->n", slopes, _covariance(other), slopes)
    return (
        touch + trial.readings,
        found - touch - trial.readings,
        np.sqrt(variance + touch_sigma**2),
    )


def _summary(off: np.ndarray, sigma: np.ndarray) -> tuple[float, float, float]:
    """Root mean square, mean, and root mean square in standard deviations."""
    return (
        float(np.sqrt(np.nanmean(off**2))),
        float(np.nanmean(off)),
        float(np.sqrt(np.nanmean((off / sigma) ** 2))),
    )
