"""How far the tip had gone at each frame, and along which axis: from the robot's reports."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from jaxtyping import Float

from estimator import read_poses

_MOST_ASIDE_MM = 0.05
"""That a withdrawal may leave its line: then the spot has moved by as much, some 7 px."""


def withdrawal(
    times: Float[np.ndarray, "n"], poses_file: Path, *, source: Path
) -> tuple[Float[np.ndarray, "n"], Float[np.ndarray, "3"]]:
    """How far the tip has gone since the first frame, and the mean axis.

    Between the robot's reports the place is interpolated: at 0.1 mm/s and 200 Hz the latest report
    lags by up to 0.5 um, which is one standard error of the half-angle in 5 mm.

    Args:
        times: of the frames, s, on the poses' clock.
        poses_file: see `read_poses`.
        source: of the frames, for messages.

    Returns:
        Readings along the axis, mm, and the unit vector from the tip towards the wall, both in the
        poses' frame.

    Raises:
        ValueError: poses that cannot be read or do not span the frames, or no withdrawal.
    """
    poses = list(read_poses(poses_file))
    known = np.array([pose.time_s for pose in poses])
    # Times that nobody knows are NaN and lie nowhere.
    if not (known[0] <= times.min() and times.max() <= known[-1]):
        raise ValueError(
            f"{poses_file} holds poses from {known[0]:.3f} to {known[-1]:.3f} s, the frames of "
            f"{source} go from {times.min():.3f} to {times.max():.3f} s. Record the robot's poses "
            "on the frames' clock, from before the first frame until after the last."
        )
    reported = np.array([pose.position_mm for pose in poses])
    places = np.stack([np.interp(times, known, column) for column in reported.T], axis=1)
    # The reports between which the frames lie, however few.
    first = np.searchsorted(known, times.min(), side="right") - 1
    last = np.searchsorted(known, times.max(), side="left")
    axis = np.mean([pose.axis for pose in poses[first : last + 1]], axis=0)
    axis /= np.linalg.norm(axis)
    gone = places[0] - places
    readings = gone @ axis
    aside = np.linalg.norm(gone - readings[:, None] * axis, axis=1).max()
    if aside > _MOST_ASIDE_MM:
        raise ValueError(
            f"{source} is no withdrawal: the tip leaves the line of its axis by {aside:.2f} mm; "
            f"{_MOST_ASIDE_MM} mm are allowed. Withdraw the tip along its axis, one spot a trial."
        )
    return readings, axis
