"""A withdrawal: the tip's distance from its first place along a straight line, frame by frame."""

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from eyespot.formats.inputs import InputError
from eyespot.formats.poses import PoseTrack, RobotKeys, turned

if TYPE_CHECKING:
    from jaxtyping import Float

MOST_ASIDE_MM = 0.05
"""Largest distance of a withdrawal from its line. The spot then moves by as much, about 7 px."""
BORESIGHT_SIGMA = math.radians(3.0)
"""Standard deviation of the beam's angle from the tool's axis, rad. A fibre of 0.5 mm in a tube
that is 0.1 mm wider and holds it over 2 mm can lie 3° askew."""
MOST_ASKEW_DEG = 10.0
"""Largest angle between the tip's motion and the tool's axis: three standard deviations of
`BORESIGHT_SIGMA`. A larger angle is another motion, or the axis is given in another frame."""
_LEAST_TRAVEL_MM = 0.1
"""Shortest withdrawal: from it on, errors of 2 um in the robot's readings make less than 2 %."""
_MOST_TRAVEL_MM = 60.0
"""Longest withdrawal: more than twice the length of an eye, 24 mm."""
_OTHER_CLOCK = 100.0
"""How much longer than the frames poses last that may count milliseconds as seconds."""
_DEEPEST_MM = 0.1
"""How far a tip may go beyond the place of its contact: five standard deviations of a contact."""
_RATE_S = 0.05
"""Clocks without stamps differ by about this; over it a robot's speed is taken."""
DELAYS = 401
"""Clock offsets of which readings are computed: 200 steps, four standard deviations, on each side
of 0. Between them a robot that sets off is rounded by an eighth of a step, 0.1 ms of 0.05 s."""
_STRAIGHT = 6.0
"""Standard deviations of a pose's noise up to which a motion counts as straight in time: four of a
pose beside a line between two such. Wiggles of the noise would seem to tell the clock."""
_FOR_EVER_S = 1e3
"""Longer than any clock is late."""
_LEAST_NOISE_MM = 1e-5
"""Least noise of a pose: files have five or six digits."""
_EXPOSURE_PARTS = 32
"""In the middles of so many parts of an exposure the tip's place is averaged."""


class ReportedWithdrawal(NamedTuple):
    """The tip's way in the robot's frame.

    Attributes:
        readings: (n,), distance of the tip from its place in the first frame, along `motion`, mm.
        motion: the motion, reversed, a unit vector towards the wall.
        axis: the tool's mean axis, a unit vector towards the wall.
        across: unit vectors of the tool's x and y axes in the middle of the withdrawal.
        delay_s: step of the clock offsets of `delayed`, s.
        delayed: (n, DELAYS), the readings if `clock_offset_s` is larger by as many steps, mm; the
            middle column has the readings themselves.
    """

    readings: "Float[np.ndarray, 'n']"
    motion: "Float[np.ndarray, '3']"
    axis: "Float[np.ndarray, '3']"
    across: "Float[np.ndarray, '2 3']"
    delay_s: float
    delayed: "Float[np.ndarray, 'n delays']"


def withdrawal_of(
    poses: PoseTrack,
    times_s: "Float[np.ndarray, 'n']",
    *,
    robot: RobotKeys,
    exposure_s: "Float[np.ndarray, 'n'] | None" = None,
    where: str = "the recording",
) -> ReportedWithdrawal:
    """The withdrawal that a robot reports of the frames of a recording.

    Positions are interpolated between poses: at 0.1 mm/s and 200 Hz the latest pose lags by up to
    0.5 um, which equals one standard error of the half-angle at 5 mm. They are means over the
    exposures: a robot that stops in the middle of one is 1 um behind at 0.1 mm/s and 0.1 s.

    Args:
        times_s: times of the frames, in the middle of their exposures, on the poses' clock.
        robot: if the first distance is free (`touch`), the sense of the motion is, too;
            `eye_from_robot` shows where the wall is.
        exposure_s: of the frames; None if they are not known.
        where: name of the recording, for messages.

    Raises:
        InputError: the poses do not cover the frames, repeat themselves, stand still, move too far,
            towards the wall or beside the tool's axis; the text names value, cause and remedy.
    """
    known = poses.times_s
    if np.isnan(times_s).any():
        raise InputError(
            f"{np.isnan(times_s).sum()} of {times_s.size} frames of {where} have no time, so that "
            "no pose belongs to them. Give the times: frames.csv beside the images (file,time_s), "
            "or --fps."
        )
    if len(known) > 1 and known[0] == known[-1]:
        raise InputError(
            f"All {len(known)} poses of {where} have the time {known[0]:.3f} s. Name the column of "
            "their times in robot.columns, or record them again."
        )
    if not (known[0] <= times_s.min() and times_s.max() <= known[-1]):
        raise InputError(
            f"The robot's poses go from {known[0]:.3f} to {known[-1]:.3f} s, but the frames of "
            f"{where} from {times_s.min():.3f} to {times_s.max():.3f} s. Record the poses on the "
            "frames' clock, from before the first frame until after the last, or correct "
            "robot.clock_offset_s or the times' column (robot.columns)."
        )
    # Use all poses between which the frames lie, even if they are only two.
    first = int(np.searchsorted(known, times_s.min(), side="right")) - 1
    last = int(np.searchsorted(known, times_s.max(), side="left"))
    _check_times(poses, first, last, where)
    parts = np.zeros((times_s.size, 1))
    if exposure_s is not None:
        middles = (np.arange(_EXPOSURE_PARTS) + 0.5) / _EXPOSURE_PARTS - 0.5
        parts = exposure_s[:, None] * middles
    moments = times_s[:, None] + parts

    along = [np.interp(moments, known, x).mean(axis=1) for x in poses.positions_mm.T]
    places = np.stack(along, axis=1)
    axis = poses.axes[first : last + 1].mean(axis=0)
    axis /= np.linalg.norm(axis)
    motion, readings, aside = straight_line(places, axis)
    lasting_s = float(known[-1] - known[0]), float(np.ptp(times_s))
    _check_travel(float(np.ptp(readings)), *lasting_s, where)
    askew = math.degrees(math.acos(min(float(motion @ axis), 1.0)))
    if aside > MOST_ASIDE_MM or askew > MOST_ASKEW_DEG:
        raise InputError(
            f"{where} is no withdrawal: the tip leaves a straight line by {aside:.2f} mm, and the "
            f"line is {askew:.1f}° from the tool's axis; {MOST_ASIDE_MM} mm and "
            f"{MOST_ASKEW_DEG:g}° are allowed. Withdraw the tip along its axis, one spot a trial; "
            "if it was, correct robot.tool_axis or robot.columns."
        )
    _check_sense(readings, axis, robot, where)
    middle = poses.rotations[(first + last) // 2]
    across = np.array([turned(side, tuple(middle)) for side in ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0))])
    knots = straight_pieces(known, -poses.positions_mm @ motion)

    def delayed_by(offset_s: float) -> "Float[np.ndarray, 'n']":
        gone = (np.interp(moments - late_s, *knots).mean(axis=1) for late_s in (offset_s, 0.0))
        changes = np.subtract(*gone)
        return np.asarray(readings + changes - changes[0])

    delay_s = 8.0 * (robot.clock_sigma_s or _RATE_S) / (DELAYS - 1)
    delayed = [delayed_by(delay_s * (step - DELAYS // 2)) for step in range(DELAYS)]
    return ReportedWithdrawal(readings, motion, axis, across, delay_s, np.stack(delayed, axis=1))


def straight_pieces(
    times_s: "Float[np.ndarray, 'n']", along_mm: "Float[np.ndarray, 'n']"
) -> "tuple[Float[np.ndarray, 'k'], Float[np.ndarray, 'k']]":
    """Knots of a motion in pieces of constant speed, as few as its noise permits.

    After Douglas and Peucker (1973). The noise is that of differences between neighbours. The
    first and the last piece go on for ever: poses may begin with the first frame, and a tip that
    rested before would tell the clock.
    """
    bends = np.abs(np.diff(along_mm, 2))
    noise_mm = float(np.mean(bends)) * math.sqrt(math.pi / 12) if bends.size else 0.0
    most = _STRAIGHT * max(noise_mm, _LEAST_NOISE_MM)
    kept, pieces = {0, len(times_s) - 1}, [(0, len(times_s) - 1)]
    while pieces:
        first, last = pieces.pop()
        inner, ends = slice(first, last + 1), [first, last]
        line = np.interp(times_s[inner], times_s[ends], along_mm[ends])
        off = np.abs(along_mm[inner] - line)
        if off.max() > most:
            middle = first + int(np.argmax(off))
            kept.add(middle)
            pieces += [(first, middle), (middle, last)]
    at = sorted(kept)
    knots_s, knots_mm = times_s[at], along_mm[at]
    if len(at) > 1:
        speeds = np.diff(knots_mm)[[0, -1]] / np.diff(knots_s)[[0, -1]]
        beyond_s = _FOR_EVER_S * np.array([-1.0, 1.0])
        beyond = knots_mm[[0, -1]] + speeds * beyond_s
        knots_s[[0, -1]] += beyond_s
        knots_mm[[0, -1]] = beyond
    return knots_s, knots_mm


def straight_line(
    places_mm: "Float[np.ndarray, 'n 3']", axis: "Float[np.ndarray, '3']"
) -> "tuple[Float[np.ndarray, '3'], Float[np.ndarray, 'n'], float]":
    """The line through a tip's places: the way back along it, towards the wall as the axis is.

    Returns:
        The line's unit vector; each place's distance from the first one against it, mm; and the
        largest distance from the line through the first place, mm.
    """
    gone = places_mm[0] - places_mm
    _, _, lines = np.linalg.svd(gone - gone.mean(axis=0), full_matrices=False)
    motion = np.asarray(lines[0] * np.copysign(1.0, lines[0] @ axis))
    along = gone @ motion
    return motion, along, float(np.linalg.norm(gone - along[:, None] * motion, axis=1).max())


def _check_times(poses: PoseTrack, first: int, last: int, where: str) -> None:
    """Refuse poses that share their times: an interpolation between them has no meaning."""
    window = slice(first, last + 1)
    equal = np.diff(poses.times_s[window]) == 0
    if not equal.any():
        return
    same = np.diff(np.hstack([poses.positions_mm, poses.rotations])[window], axis=0) == 0
    twice = int((equal & same.all(axis=1)).sum())
    what = f"{equal.sum()} of {last - first + 1} poses of {where} have the time of the one before"
    at_s = poses.times_s[window][:-1][equal][0]
    if twice == equal.sum():
        raise InputError(
            f"{what}, first at {at_s:.6f} s, and its place, too. Rows or a whole recording are in "
            "the file twice. Remove the repeated rows."
        )
    raise InputError(
        f"{what}, first at {at_s:.6f} s, but another place. The times are too coarse, or of "
        "another clock. Write the times with more digits, or name their column in robot.columns."
    )


_UNIT_REMEDY = (
    "write its own unit into robot.unit ('m', 'mm' or 'um') and, if their names state another, "
    "rename its columns (such as x_mm to x_m)"
)


def _check_travel(travel_mm: float, poses_s: float, frames_s: float, where: str) -> None:
    if travel_mm < 1e-9:
        raise InputError(
            f"The robot stands still in all frames of {where}; a withdrawal is at least "
            f"{_LEAST_TRAVEL_MM} mm long. The robot's file has stopped, or it has another column "
            "or topic of poses. Correct robot.columns or robot.pose_topic, or record again."
        )
    if travel_mm < _LEAST_TRAVEL_MM:
        clock = (
            f" Or its times, which last {poses_s:.4g} s and the frames' {frames_s:.4g} s, are in "
            "another unit, such as ms: rename their column to time_ms."
            if poses_s > _OTHER_CLOCK * frames_s
            else ""
        )
        raise InputError(
            f"The robot moves by {travel_mm:.4g} mm in {where}; a withdrawal is at least "
            f"{_LEAST_TRAVEL_MM} mm long. If its file is in m but taken to be in mm, or in mm but "
            f"taken to be in µm (the travel is then {1e3 * travel_mm:.4g} mm), {_UNIT_REMEDY}; "
            f"otherwise it stood still.{clock}"
        )
    if travel_mm > _MOST_TRAVEL_MM:
        raise InputError(
            f"The robot moves by {travel_mm:.4g} mm in {where}; a withdrawal is at most "
            f"{_MOST_TRAVEL_MM:g} mm long, more than an eye. If its file is in µm but taken to be "
            f"in mm, or in mm but taken to be in m (the travel is then {1e-3 * travel_mm:.4g} mm), "
            f"{_UNIT_REMEDY}; otherwise leave out the frames of other motions."
        )


def _check_sense(
    readings: "Float[np.ndarray, 'n']",
    axis: "Float[np.ndarray, '3']",
    robot: RobotKeys,
    where: str,
) -> None:
    """Refuse an axis that points away from the wall, and a way that leads into it."""
    if robot.eye_from_robot is not None:
        height = turned((axis[0], axis[1], axis[2]), robot.eye_from_robot)[2]
        if height > 0:
            raise InputError(
                f"The tool's axis points to the microscope in {where} (z = {height:+.2f} of the "
                "unit vector in the eye's frame, below 0 towards the wall). Reverse "
                f"robot.tool_axis (now {robot.tool_axis!r}) or robot.travel_axis, or correct "
                "robot.eye_from_robot."
            )
    begin_mm = robot.touch[0] if isinstance(robot.touch, tuple) else 0.0
    deep, far = -float(readings.min()), float(readings.max())
    if robot.touch == "free" or deep <= begin_mm + _DEEPEST_MM:
        return
    if far < deep:
        raise InputError(
            f"The tip moves along the tool's axis in {where}, {deep:.3g} mm towards the wall, from "
            f"which it is {begin_mm:.3g} mm away in the first frame; a withdrawal goes against the "
            "axis. Either the axis points away from the wall: reverse robot.tool_axis (now "
            f"{robot.tool_axis!r}) or robot.travel_axis. Or the positions count backwards: correct "
            "the robot's file. Or it is an approach: state robot.touch = 'free'."
        )
    raise InputError(
        f"The tip goes {deep:.3g} mm further towards the wall in {where} than in the first frame, "
        f"in which it is {begin_mm:.3g} mm away; {_DEEPEST_MM} mm more are allowed. Leave out the "
        "frames before the contact, or state robot.touch = 'free'."
    )
