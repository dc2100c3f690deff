"""Distance of the tip at each frame, direction of its motion and mean axis, from poses."""

from __future__ import annotations

import math
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from estimator import read_poses
from estimator.files import turned
from optics import InputError

_MOST_ASIDE_MM = 0.05
"""Largest distance of a withdrawal from its line. The spot then moves by as much, about 7 px."""
_MOST_ASKEW_DEG = 10.0
"""Largest angle between the tip's motion and the tool's axis: three standard deviations of
`BORESIGHT_SIGMA`. A larger angle is another motion, or the axis is given in another frame."""


class Withdrawal(NamedTuple):
    """A straight motion of the tip away from the wall.

    Attributes:
        readings: distance from the first frame along the motion, mm.
        motion: unit vector of the motion, reversed, so that it points towards the wall.
        axis: unit vector of the tool's mean axis, towards the wall.
        across: unit vectors of the tool's x and y axes in the middle of the withdrawal.
    """

    readings: Float[np.ndarray, "n"]
    motion: Float[np.ndarray, "3"]
    axis: Float[np.ndarray, "3"]
    across: Float[np.ndarray, "2 3"]


def withdrawal(times: Float[np.ndarray, "n"], poses_file: Path, *, source: Path) -> Withdrawal:
    """Distance of the tip since the first frame, its direction, and the tool's mean axis.

    Positions are interpolated between poses: at 0.1 mm/s and 200 Hz the latest pose lags by up to
    0.5 um, which equals one standard error of the half-angle at 5 mm.

    Args:
        times: times of the frames, s, on the poses' clock.
        poses_file: see `read_poses`.
        source: source of the frames, for messages.

    Returns:
        The withdrawal, in the poses' frame.

    Raises:
        InputError: poses that cannot be read or do not cover the frames, or no withdrawal.
    """
    poses = list(read_poses(poses_file))
    known = np.array([pose.time_s for pose in poses])
    # An unknown time is NaN, for which these comparisons are false.
    if not (known[0] <= times.min() and times.max() <= known[-1]):
        raise InputError(
            f"{poses_file} has poses from {known[0]:.3f} to {known[-1]:.3f} s, but the frames of "
            f"{source} go from {times.min():.3f} to {times.max():.3f} s. Record the robot's poses "
            "on the frames' clock, from before the first frame until after the last."
        )
    reported = np.array([pose.position_mm for pose in poses])
    places = np.stack([np.interp(times, known, column) for column in reported.T], axis=1)
    # Use all poses between which the frames lie, even if they are only two.
    first = np.searchsorted(known, times.min(), side="right") - 1
    last = np.searchsorted(known, times.max(), side="left")
    axis = np.mean([pose.axis for pose in poses[first : last + 1]], axis=0)
    axis /= np.linalg.norm(axis)
    gone = places[0] - places
    motion = _direction(gone, axis)
    readings = gone @ motion
    aside = np.linalg.norm(gone - readings[:, None] * motion, axis=1).max()
    askew = math.degrees(math.acos(min(float(motion @ axis), 1.0)))
    if aside > _MOST_ASIDE_MM or askew > _MOST_ASKEW_DEG:
        raise InputError(
            f"{source} is no withdrawal: the tip leaves a straight line by {aside:.2f} mm, and the "
            f"line is {askew:.1f}° from the tool's axis; {_MOST_ASIDE_MM} mm and "
            f"{_MOST_ASKEW_DEG:g}° are allowed. Withdraw the tip along its axis, one spot a trial."
        )
    middle = poses[(first + last) // 2].rotation
    across = np.array([turned(side, middle) for side in ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0))])
    return Withdrawal(readings, motion, axis, across)


def _direction(
    gone: Float[np.ndarray, "n 3"], axis: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "3"]:
    """Unit vector of the straight line through the places, on the axis's side."""
    _, travel, lines = np.linalg.svd(gone - gone.mean(axis=0), full_matrices=False)
    # A tip at rest has no direction.
    line = lines[0] if travel[0] > _MOST_ASIDE_MM else axis
    return np.asarray(line * np.copysign(1.0, line @ axis))
