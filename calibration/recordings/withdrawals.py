"""Distance of the tip at each frame and mean axis, from the robot's poses."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from jaxtyping import Float

from estimator import read_poses
from optics import InputError

_MOST_ASIDE_MM = 0.05
"""Largest distance of a withdrawal from its line. The spot then moves by as much, about 7 px."""


def withdrawal(
    times: Float[np.ndarray, "n"], poses_file: Path, *, source: Path
) -> tuple[Float[np.ndarray, "n"], Float[np.ndarray, "3"]]:
    """Distance of the tip since the first frame, and the mean axis.

    Positions are interpolated between poses: at 0.1 mm/s and 200 Hz the latest pose lags by up to
    0.5 um, which equals one standard error of the half-angle at 5 mm.

    Args:
        times: times of the frames, s, on the poses' clock.
        poses_file: see `read_poses`.
        source: source of the frames, for messages.

    Returns:
        Readings along the axis, mm, and the unit vector from the tip towards the wall, both in the
        poses' frame.

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
    readings = gone @ axis
    aside = np.linalg.norm(gone - readings[:, None] * axis, axis=1).max()
    if aside > _MOST_ASIDE_MM:
        raise InputError(
            f"{source} is no withdrawal: the tip leaves the line of its axis by {aside:.2f} mm; "
            f"{_MOST_ASIDE_MM} mm are allowed. Withdraw the tip along its axis, one spot per trial."
        )
    return readings, axis
