"""The states of a frame, its model on the cells of a window, and what is known of it beforehand."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from estimator.pixels.beam import POSE, Pose, Sweep
from estimator.pixels.cells import SHADES, CellLight, rolled
from estimator.pixels.robot import RobotPose

GAIN, AMBIENT, SHADE, BLUR, TAILS = POSE, POSE + 1, slice(POSE + 2, POSE + 7), POSE + 7, POSE + 8
SHIFT = slice(POSE + 9, POSE + 11)
OWN = POSE + 11
"""States of a frame: those of its pose, log gain, log ambient light and its shading by `SHADES`,
the variance of the blur, px², its excess kurtosis, and how far the wall has moved to the right and
downwards in the image, px."""
_SHADE = np.array([0.5, 0.5, 0.3, 0.3, 0.3])
"""Standard deviations. A film of water that reflects a lamp adds a bump to the ambient light."""
_BLUR_PX2 = 2.0
"""Half width of the Cauchy distribution of the blur's variance. Most images are in focus, at NA
0.05 within 0.4 mm. Nobody knows how far the others are out of focus."""
_SATURATED_PX2 = 0.02
"""Standard deviation of that variance where the spot is saturated: its blur cannot be told from its
size there, and counts as part of what makes it look larger (`saturation`)."""
_KURTOSIS = 1.0  # standard deviation of the blur's excess kurtosis; a disc has -1


class Direction(NamedTuple):
    """What the robot says about the beam: a unit vector and its standard deviation, rad."""

    axis: Float[np.ndarray, "3"]
    sigma: float


class Linear(NamedTuple):
    """A frame's model at its state on the cells of a window.

    Attributes:
        residual: log of the measured light, less its model.
        slopes: derivatives of the model by the frame's states.
        shared: derivatives by the beam's own parameters.
        weight: 1 over the variance; 0 for cells that are not used.
    """

    residual: Float[np.ndarray, "n"]
    slopes: Float[np.ndarray, "16 n"]
    shared: Float[np.ndarray, "q n"]
    weight: Float[np.ndarray, "n"]

    def after(self, right: int, down: int) -> Linear:
        """The model after the window has moved by some cells; new cells have no weight."""
        return Linear(*(rolled(part, right, down) for part in self))


@dataclass(frozen=True, eq=False)
class FrameState:
    """A frame with what is believed of it.

    Attributes:
        cells: its light.
        pose: tip and axis.
        log_gain: of full wells over irradiance per unit power, mm².
        log_ambient: of the ambient light over the beam's power, 1/mm².
        direction: of the beam by the robot, or None.
        ambient_prior: mean and standard deviation of `log_ambient`.
        sweep: motion during the exposure.
        robot: where the robot says the tool is.
        shade: logarithm of the ambient light less that in the middle, in terms of `SHADES`.
        blur_px2: variance of the image's blur.
        kurtosis: its excess kurtosis.
        shift: of the wall since `cells` were cut, px.
        shift_sigma: its standard deviation before the frame was seen, px. The map begins with the
            first frame, so that hardly any is its own.
    """

    cells: CellLight
    pose: Pose
    log_gain: float
    log_ambient: float
    direction: Direction | None
    ambient_prior: tuple[float, float]
    sweep: Sweep | None = None
    robot: RobotPose | None = None
    shade: tuple[float, ...] = (0.0,) * len(SHADES)
    blur_px2: float = 0.0
    kurtosis: float = 0.0
    shift: tuple[float, float] = (0.0, 0.0)
    shift_sigma: float = 1e-3

    @property
    def saturated(self) -> bool:
        """Whether the spot is at full scale."""
        return self.cells.ceiling < math.inf

    @property
    def axis_off(self) -> float:
        """How far the axis is from the robot's, in standard deviations; 0 if it says nothing."""
        if self.direction is None:
            return 0.0
        return math.acos(min(1.0, float(self.pose.axis @ self.direction.axis))) / (
            self.direction.sigma
        )


def prior_of(frame: FrameState) -> tuple[np.ndarray, np.ndarray]:
    """Precision of a frame's states before it is seen, and the pull towards their means."""
    precision, pull = np.zeros((OWN, OWN)), np.zeros(OWN)
    mean, sigma = frame.ambient_prior
    precision[AMBIENT, AMBIENT] = sigma**-2
    pull[AMBIENT] = (mean - frame.log_ambient) / sigma**2
    precision[SHADE, SHADE] = np.diag(_SHADE**-2)
    pull[SHADE] = np.array(frame.shade) / -(_SHADE**2)
    precision[BLUR, BLUR] = 1.0 / _blur_scale(frame) ** 2
    pull[BLUR] = -precision[BLUR, BLUR] * frame.blur_px2
    precision[TAILS, TAILS] = _KURTOSIS**-2
    pull[TAILS] = -frame.kurtosis / _KURTOSIS**2
    precision[SHIFT, SHIFT] = frame.shift_sigma**-2 * np.eye(2)
    pull[SHIFT] = np.array(frame.shift) / -(frame.shift_sigma**2)
    if frame.direction is not None:
        across = np.stack([frame.pose.first, frame.pose.second])
        weight = frame.direction.sigma**-2
        precision[3:POSE, 3:POSE] = weight * np.eye(2)
        pull[3:POSE] = weight * across @ frame.direction.axis
    return precision, pull


def prior_cost(frame: FrameState) -> float:
    """-2 log of the probability of a frame's states before it is seen, up to a constant."""
    mean, sigma = frame.ambient_prior
    cost = ((frame.log_ambient - mean) / sigma) ** 2
    cost += float(np.sum(np.square(frame.shade / _SHADE)))
    cost += _blur_cost(frame) + (frame.kurtosis / _KURTOSIS) ** 2
    cost += sum(x * x for x in frame.shift) / frame.shift_sigma**2
    if frame.direction is not None:
        off = np.cross(frame.pose.axis, frame.direction.axis)
        cost += float(off @ off) / frame.direction.sigma**2
    return cost


def _blur_scale(frame: FrameState) -> float:
    return _SATURATED_PX2 if frame.saturated else math.hypot(_BLUR_PX2, frame.blur_px2)


def _blur_cost(frame: FrameState) -> float:
    if frame.saturated:
        return (frame.blur_px2 / _SATURATED_PX2) ** 2
    return math.log1p((frame.blur_px2 / _BLUR_PX2) ** 2)
