"""What a recording says about its rig file: stated, found, and what to do, a line each.

It reads at most `_MOST_FRAMES` frames and needs no fit. What a recording cannot show is said to be
so: an offset of the clocks at constant speed equals an error of the contact.
"""

import itertools
import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from eyespot.estimator.camera_noise import camera_noise
from eyespot.estimator.distance.consistency import CONTRADICTION_SIGMAS
from eyespot.estimator.distance.withdrawal import withdrawal_of
from eyespot.estimator.ghost import GhostWatch
from eyespot.estimator.recording import Recording
from eyespot.estimator.run.options import Options
from eyespot.estimator.sources.source import Frame
from eyespot.formats.inputs import InputError
from eyespot.formats.poses import PoseTrack, Quaternion, RobotKeys, turned
from eyespot.formats.spot import Spot

_MOST_FRAMES = 100
_FEWEST_SPOTS = 5
_STEADY = 0.2
"""Relative change of the robot's speed below which a clock's offset looks like another contact."""
_WIDE_CORE = 1.15
"""Light at contact over the fibre's radius above which the recording begins later. A spot's
semi-minor axis in mm is that of the wall to 10 % at c = 5 mm."""
_GAP_STEPS = 20.0  # times the usual step of the poses, from which they are missing
_NOISE_TOLERANCE = 0.2  # relative difference of two standard deviations of noise
_SATURATED_SHARE = 0.01  # part of a spot's pixels
_DARK_LEVEL_TOLERANCE_DN = 3.0  # difference of a dark level that is worth a word, of 255


class RigCheck(NamedTuple):
    """What was found.

    Attributes:
        title: how many frames were looked at.
        lines: columns key, stated, found, verdict (right, wrong, unknown) and remedy.
        first: the first frame with a spot, and the spot; None without any.
        travel_mm, radius_px: of the spots, by the robot and in the images; empty without poses.
        levels, sigmas: noise against light, in full wells; empty if it was not measured.
    """

    title: str
    lines: pd.DataFrame
    first: tuple[Frame, Spot] | None
    travel_mm: np.ndarray
    radius_px: np.ndarray
    levels: np.ndarray
    sigmas: np.ndarray

    def figure(self) -> Figure:
        """The first spot with its contour, its size against the travel, noise against level."""
        figure = Figure(figsize=(12, 4), layout="constrained")
        image, size, noise = figure.subplots(1, 3)
        if self.first is not None:
            frame, spot = self.first
            image.imshow(frame.image / max(float(frame.image.max()), 1.0), cmap="gray")
            turn = np.linspace(0, 2 * math.pi, 200)
            wave = spot.semi_major_px * np.cos(turn) + 1j * spot.semi_minor_px * np.sin(turn)
            wave = wave * np.exp(1j * spot.angle_rad)
            image.plot(spot.x_px + wave.real, spot.y_px + wave.imag, color="#2aa198", lw=1.2)
            image.set_title(f"frame {frame.index}: half-maximum contour")
        image.set_axis_off()
        size.plot(self.travel_mm, self.radius_px, "o", ms=4, color="#268bd2")
        size.set(xlabel="the robot's travel (mm)", ylabel="semi-minor axis (px)")
        size.set_title("spot against robot")
        noise.plot(self.levels, 100 * self.sigmas, color="#d33682")
        noise.set(xlabel="light (full wells)", ylabel="noise of a pixel's mean (%)")
        # Noise that is the same everywhere has no range of its own.
        noise.set_ylim(0.0, 120 * float(np.max(self.sigmas, initial=0.01)))
        noise.set_title("noise against level")
        return figure


def checked(recording: Recording) -> RigCheck:
    """Compare a recording with its rig.

    Raises:
        InputError: the recording or the rig file cannot be read.
        OSError: likewise.
    """
    frames = _drawn(recording)
    reader = Options(mode="subpixel").reader(recording.rig)
    results = []
    for frame in frames:
        reader.forget()
        results.append(reader.read(frame).result)
    spots = [(f, spot) for f, spot in zip(frames, results, strict=True) if isinstance(spot, Spot)]
    lines: list[tuple[str, str, str, str, str]] = []
    lines += _of_times(recording, frames)
    lines += _of_images(recording, frames, spots)
    lines += _of_wall(recording, spots)
    noise, levels, sigmas = _of_noise(recording)
    lines += noise
    travel, of_robot = _of_robot(recording, frames, spots)
    lines += of_robot
    count = recording.source.length or len(frames)
    title = f"{recording.name}: {len(frames)} of {count} frames, {len(spots)} with a spot"
    columns = ["key", "stated", "found", "verdict", "what to do"]
    return RigCheck(
        title=title,
        lines=pd.DataFrame(lines, columns=columns),
        first=spots[0] if spots else None,
        travel_mm=travel,
        radius_px=np.array([spot.semi_minor_px for _, spot in spots])[: travel.size],
        levels=levels,
        sigmas=sigmas,
    )


def _drawn(recording: Recording) -> list[Frame]:
    """At most `_MOST_FRAMES` frames, evenly over the recording."""
    count = recording.source.length or _MOST_FRAMES
    wanted = set(np.linspace(0, count - 1, min(count, _MOST_FRAMES)).round().astype(int).tolist())
    frames = [frame for frame in recording.source if frame.index in wanted and not frame.fault]
    if not frames:
        raise InputError(
            f"{recording.source.name} holds no frames. Check that it is the right one."
        )
    return frames


Line = tuple[str, str, str, str, str]


def _of_times(recording: Recording, frames: list[Frame]) -> Iterator[Line]:
    times = np.array([frame.time_s for frame in frames])
    if np.isnan(times).any():
        remedy = "Put frames.csv beside the images (file,time_s,exposure_s), or give --fps."
        yield "times", "", "none", "wrong", remedy
    elif times.size > 1:
        rate = recording.source.rate_hz
        said = f"{times[-1] - times[0]:.2f} s" + (f", {rate:.3g} frames a second" if rate else "")
        steps = np.diff(times)
        uneven = steps.max() > 3 * np.median(steps)
        yield (
            *("times", "", said, "wrong" if uneven else "right"),
            "Frames are missing, or times jump." if uneven else "",
        )
    exposures = np.array([frame.exposure_s for frame in frames])
    if np.isnan(exposures).any():
        remedy = "Fits take each frame's gain as free; exposure_s in frames.csv makes it known."
        yield "exposure_s", "", "unknown", "unknown", remedy
    pairs = [*itertools.pairwise(frames)]
    alike = [np.array_equal(one.image, other.image) for one, other in pairs]
    same = sum(alike)
    at_once = sum(
        one.time_s == other.time_s and not equal
        for (one, other), equal in zip(pairs, alike, strict=True)
    )
    if at_once:
        remedy = "Stamp each image with its own time, with more digits."
        yield "times", "", f"{at_once} frames have the time of another", "wrong", remedy
    if same:
        remedy = "A capture card repeats frames: fits count each once."
        yield "frames", "", f"{same} equal the one before", "right", remedy


def _of_images(
    recording: Recording, frames: list[Frame], spots: list[tuple[Frame, Spot]]
) -> Iterator[Line]:
    view, camera = recording.view, recording.rig.camera
    height, width = frames[0].image.shape[:2]
    if view is None:
        remedy = "State microscope.calibration, or the numbers of [microscope] and wall.radius_mm."
        yield "microscope", "nothing", f"{width}x{height} px", "wrong", remedy
    else:
        right = (view.width_px, view.height_px) == (width, height)
        yield (
            *("microscope.width_px", f"{view.width_px}x{view.height_px}", f"{width}x{height}"),
            *(("right", "") if right else ("wrong", "Calibrate at the images' size.")),
        )
    response = recording.rig.response
    full = response.full_scale_of(frames[0].image)
    brightest = max(float(frame.image.max()) for frame in frames)
    clipped = [spot.saturated for _, spot in spots]
    part = float(np.median(clipped)) if clipped else 0.0
    yield (
        *("camera.full_scale", f"{full:g}", f"values up to {brightest:g}"),
        *(
            ("wrong", f"{part:.0%} of the spot is clipped: halve the exposure.")
            if part > _SATURATED_SHARE
            else ("right", "")
        ),
    )
    dark = float(min(np.quantile(frame.image, 0.001) for frame in frames))
    above = dark < camera.black_level_dn - _DARK_LEVEL_TOLERANCE_DN * full / 255
    yield (
        *("camera.black_level_dn", f"{camera.black_level_dn:g}", f"darkest pixels {dark:g}"),
        *(("wrong", "Measure it with the lens covered.") if above else ("right", "")),
    )
    found = f"{len(spots)} of {len(frames)}"
    enough = len(spots) >= min(_FEWEST_SPOTS, len(frames))
    remedy = "" if enough else "`eyespot track RECORDING --overlay DIR` draws what it sees."
    yield "spots", "", found, "right" if enough else "wrong", remedy
    watch = GhostWatch()
    for frame, spot in spots:
        watch.look(frame.image, spot)
    if (ghost := watch.strongest) is not None:
        right_px, down_px = ghost.shift_px
        found = (
            f"at least {ghost.share:.0%} of the spot at {right_px:+.0f}, {down_px:+.0f} px from it"
        )
        remedy = "Look for reflexes of a cover glass, a lens or the eye."
        yield "ghost", "none", found, "wrong", remedy


def _of_wall(recording: Recording, spots: list[tuple[Frame, Spot]]) -> Iterator[Line]:
    """What no microscope over an eye can have."""
    view = recording.view
    if view is None or view.plane_normal is not None:
        return
    height, radius = view.pinhole_height_mm, view.eye_radius_mm
    if height < radius:
        yield (
            *("microscope.pinhole_height_mm", f"{height:g} mm", "inside the eye", "wrong"),
            f"A microscope's pinhole lies outside of the eye, whose radius is {radius:g} mm: state "
            "the height in mm, often near 200.",
        )
    if spots:
        try:
            view.require_wall_at(np.array([(spot.x_px, spot.y_px) for _, spot in spots]))
        except InputError as error:
            yield "wall.radius_mm", f"{radius:g} mm", "spots beside the wall", "wrong", f"{error}"


def _of_noise(recording: Recording) -> tuple[list[Line], np.ndarray, np.ndarray]:
    none: np.ndarray = np.empty(0)
    if recording.view is None:
        return [], none, none
    stated = camera_noise(recording.view)
    try:
        view = recording.measured().view
    except InputError as error:
        return [("camera.noise", "", "not measured", "unknown", f"{error}")], none, none
    assert view is not None
    found = camera_noise(view)
    assert found is not None
    levels = np.linspace(0.02, 0.9, 60)
    sigmas = np.sqrt(found.variance(levels))
    sheet = found.sheet
    said = f"full well {sheet.full_well_e:.0f} e, read noise {sheet.read_noise_e:.1f} e"
    if stated is None:
        return [("camera.noise", "recording", said, "right", "")], levels, sigmas
    ratio = float(np.median(sigmas / np.sqrt(stated.variance(levels))))
    other = abs(ratio - 1) > _NOISE_TOLERANCE
    remedy = f"It is {ratio:.2f} times the stated: set camera.noise = 'recording'." if other else ""
    return (
        [("camera.noise", "a sheet", said, "wrong" if other else "right", remedy)],
        levels,
        sigmas,
    )


def _of_robot(
    recording: Recording, frames: list[Frame], spots: list[tuple[Frame, Spot]]
) -> tuple[np.ndarray, list[Line]]:
    """The robot's travel at the spots, mm, and what it says."""
    none: np.ndarray = np.empty(0)
    robot = recording.rig.robot
    try:
        poses = recording.robot()
    except (InputError, OSError) as error:
        if recording.has_poses:
            return none, [("robot", "poses", "not readable", "wrong", f"{error}")]
        return none, [("robot", "", "no poses", "unknown", f"{error}")]
    times = np.array([frame.time_s for frame, _ in spots])
    if times.size < 2 or np.isnan(times).any():
        return none, [("robot", "", f"{len(poses)} poses", "unknown", "Give the frames' times.")]
    lines = [*_of_gaps(poses, times), *_of_frame(poses, robot)]
    anywhere = robot.model_copy(update={"touch": "free"})
    try:
        way = withdrawal_of(poses, times, robot=anywhere, where=recording.name)
    except InputError as error:
        return none, [*lines, ("robot", "a withdrawal", "none", "wrong", f"{error}")]
    travel = way.readings
    said = f"{np.ptp(travel):.3g} mm"
    lines.append(("robot.unit", robot.unit or "mm", f"a travel of {said}", "right", ""))
    askew = math.degrees(math.acos(min(1.0, abs(float(way.motion @ way.axis)))))
    lines.append(("robot.tool_axis", robot.tool_axis, f"{askew:.1f}° from the way", "right", ""))
    radius = np.array([spot.semi_minor_px for _, spot in spots])
    (slope, start), covariance = np.polyfit(travel, radius, 1, cov=True)
    if slope < -CONTRADICTION_SIGMAS * math.sqrt(covariance[0, 0]):
        remedy = "The spot shrinks while the robot withdraws: the travel counts the other way."
        lines.append(("robot", "away from the wall", "towards it", "wrong", remedy))
    lines += _of_contact(recording, float(start), float(slope))
    lines += _of_clock(poses, times, robot, radius)
    return travel, lines


def _of_gaps(poses: PoseTrack, times: np.ndarray) -> Iterator[Line]:
    """Times in which the robot's file says nothing, while frames were taken."""
    steps = np.diff(poses.times_s)
    begin = (
        np.flatnonzero(steps > _GAP_STEPS * np.median(steps)) if steps.size else steps.astype(int)
    )
    for first in begin:
        from_s, to_s = poses.times_s[first : first + 2]
        inside = int(np.count_nonzero((from_s < times) & (times < to_s)))
        if inside:
            yield (
                *("robot", "poses", f"none from {from_s:.3f} to {to_s:.3f} s", "wrong"),
                f"{inside} frames lie between: a pause there would not be seen. Leave them out, or "
                "record again.",
            )


def _of_frame(poses: PoseTrack, robot: RobotKeys) -> Iterator[Line]:
    axis = np.mean([pose.axis for pose in poses], axis=0)
    if robot.eye_from_robot is not None:
        x, y, z = turned((axis[0], axis[1], axis[2]), robot.eye_from_robot)
        right = z < 0
        remedy = "" if right else "The light would leave the eye: reverse robot.tool_axis."
        found = f"axis ({x:.2f}, {y:.2f}, {z:.2f}) in the eye"
        yield "robot.eye_from_robot", "stated", found, "right" if right else "wrong", remedy
        return
    proposed = _proposed(axis)
    yield (
        *("robot.eye_from_robot", "nothing", f"proposed {list(proposed)}", "unknown"),
        "The turn about the microscope's axis is not seen in one withdrawal: compare a motion to "
        "the right in the image with the robot's x and y.",
    )


def _proposed(axis: np.ndarray) -> Quaternion:
    """The smallest turn between right-angled frames that points the light at the wall."""
    half = math.sqrt(0.5)
    turns: list[Quaternion] = [
        (0.0, 0.0, 0.0, 1.0),
        (1.0, 0.0, 0.0, 0.0),
        *((sign * half, 0.0, 0.0, half) for sign in (1, -1)),
        *((0.0, sign * half, 0.0, half) for sign in (1, -1)),
    ]
    x, y, z = axis.tolist()
    # Of turns that point alike, the one that turns less.
    return min(turns, key=lambda turn: (round(turned((x, y, z), turn)[2], 1), -turn[3]))


def _of_contact(recording: Recording, start_px: float, slope: float) -> Iterator[Line]:
    view, rig = recording.view, recording.rig
    if view is None:
        return
    touch, rim = rig.robot.touch, rig.instrument.fibre_diameter_mm / 2
    at_contact = start_px * view.scale_mm_px
    found = f"light of {at_contact:.3f} mm in the first frame (fibre: {rim:.3f} mm)"
    if touch != "contact":
        yield "robot.touch", f"{touch}", found, "unknown", ""
    elif at_contact > _WIDE_CORE * rim:
        late = (at_contact - rim) / (slope * view.scale_mm_px)
        remedy = (
            f"Light at contact is no wider than the fibre: the recording begins some {late:.2g} mm "
            "later, or the scale or the fibre is wrong. State robot.touch = 'free'."
        )
        yield "robot.touch", touch, found, "wrong", remedy
    else:
        yield "robot.touch", touch, found, "right", ""


def _of_clock(
    poses: PoseTrack, times: np.ndarray, robot: RobotKeys, radius: np.ndarray
) -> Iterator[Line]:
    """The offset at which the spot's size follows the robot best, if its speed changes."""
    known, places = poses.times_s, poses.positions_mm
    stated = f"{robot.clock_offset_s:g} ± {robot.clock_sigma_s:g} s"
    # From frame to frame: from pose to pose, their noise would look like another speed.
    seen = np.stack([np.interp(times, known, along) for along in places.T], axis=1)
    apart_s = np.diff(times)
    moves = np.linalg.norm(np.diff(seen, axis=0), axis=1)
    speeds = moves[apart_s > 0] / apart_s[apart_s > 0]
    if speeds.size < _FEWEST_SPOTS or np.std(speeds) < _STEADY * np.mean(speeds):
        remedy = (
            "At a constant speed an offset looks like another contact. Record two seconds of rest "
            "before and after."
        )
        yield "robot.clock_offset_s", stated, "cannot be observed", "unknown", remedy
        return
    offsets = np.linspace(-1.0, 1.0, 401)
    far = np.linalg.norm(places - places[0], axis=1)
    misfits = []
    for offset in offsets:
        moved = np.interp(times - offset, known, far)
        basis = np.stack([np.ones_like(moved), moved], axis=1)
        misfits.append(float(np.linalg.lstsq(basis, radius, rcond=None)[1].sum()))
    best, sigma = _minimum(offsets, np.array(misfits), times.size)
    wrong = abs(best) > CONTRADICTION_SIGMAS * math.hypot(sigma, robot.clock_sigma_s)
    remedy = f"Set it to {robot.clock_offset_s + best:.3f}." if wrong else ""
    found = f"{best:+.3f} ± {sigma:.3f} s more"
    yield "robot.clock_offset_s", stated, found, "wrong" if wrong else "right", remedy


def _minimum(x: np.ndarray, misfit: np.ndarray, count: int) -> tuple[float, float]:
    """Where a sum of squares is least, and the standard error of that by its curvature."""
    at = int(np.clip(np.argmin(misfit), 2, x.size - 3))
    near = slice(at - 2, at + 3)
    bend, slope, _ = np.polyfit(x[near] - x[at], misfit[near], 2)
    if not bend > 0:
        return float(x[at]), math.inf
    variance = misfit[at] / max(count - 3, 1)
    return float(x[at] - slope / (2 * bend)), math.sqrt(max(variance, 0.0) / bend)
