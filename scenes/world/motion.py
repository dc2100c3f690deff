"""Position of the tip over time, and the clocks of camera and robot."""

import math
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from eyespot import optics
from eyespot.formats.inputs import in_file
from eyespot.formats.poses import read_poses
from eyespot.scenes.description.scene import Scene
from eyespot.scenes.description.scene_keys import (
    MOST_FRAMES,
    Hand,
    Recorded,
    Scan,
    SceneError,
    Withdrawal,
)
from eyespot.scenes.world.geometry import SceneGeometry

_TREMOR_HZ = (8.0, 12.0)
"""Band of physiological tremor in microsurgery (Wells et al. 2013)."""
_VOLUNTARY_HZ = (0.3, 1.2)
"""Slow motion; 99 % of the power of voluntary motion lies below 2 Hz (Riviere et al. 1997)."""
_SINUSOIDS_PER_BAND = 64  # sinusoids per band: enough to look random, few enough to sum exactly
_STEP_S = 1e-6  # step of time for differences: in it the speed of a tremor changes by 1e-4
_SPEED_SEARCH_STEP_S = 1e-3
"""Step in the search for the top speed: a hundredth of the period of a tremor."""
_MAX_POSES = 2**20  # robot's poses that memory is taken for: 90 minutes at 200 Hz
_MARGIN_S = 0.1  # the robot's poses begin before the first frame and end after the last


class Poses(NamedTuple):
    """Tip (mm) and axis (unit vectors towards the wall) at several times, n x 3, eye frame."""

    tip: NDArray[np.float64]
    axis: NDArray[np.float64]


PARKED_MM, DOWN = np.array([0.0, 0.0, -1e3]), np.array([0.0, 0.0, -1.0])
"""Tip and axis far below the eye and pointing away: neither the tip nor its light is visible."""

PosesAt = Callable[[NDArray[np.float64]], Poses]
"""Poses at times in s."""


class Trajectory(NamedTuple):
    """A motion.

    Attributes:
        moments: nominal times of the camera's frames, s; the first is 0.
        at: poses at any times (s). Before its start and after its end the tip is at rest, except
            in a hand's motion.
    """

    moments: NDArray[np.float64]
    at: PosesAt

    def speed(self, times: NDArray[np.float64]) -> NDArray[np.float64]:
        """Speed of the tip, mm/s; where it jumps, as at a start from rest, the larger value."""
        before, now, after = (self.at(times + step).tip for step in (-_STEP_S, 0.0, _STEP_S))
        steps = np.maximum(
            np.linalg.norm(now - before, axis=1), np.linalg.norm(after - now, axis=1)
        )
        return steps / _STEP_S


def trajectory(geometry: SceneGeometry) -> Trajectory:
    """The scene's motion.

    Raises:
        SceneError: the motion is impossible, or its file cannot be read.
    """
    scene = geometry.scene
    match scene.motion:
        case Withdrawal() as motion:
            at = _withdrawal(geometry, motion)
        case Scan() as motion:
            at = _scan(geometry, motion)
        case Hand() as motion:
            at = _hand(geometry, motion)
        case Recorded() as motion:
            at = _recorded(motion)
    moments = _moments(scene)
    _pose_count(scene, moments[-1])
    return Trajectory(moments, at)


def frame_count(scene: Scene) -> int:
    """Number of frames of a scene for each kind of exposure.

    Raises:
        SceneError: a recorded motion cannot be read.
    """
    return _moments(scene).size


def _moments(scene: Scene) -> NDArray[np.float64]:
    """Nominal times of the camera's frames, s."""
    match scene.motion:
        case Withdrawal() as motion:
            travelled = np.linspace(0.0, motion.travel_mm, motion.frames)
            return np.round(travelled / motion.speed_mm_s, 9)  # 0.3, not 0.30000000000000004
        case Scan() as motion:
            duration = motion.length_mm / motion.speed_mm_s
        case Hand() as motion:
            duration = motion.duration_s
        case Recorded() as motion:
            duration = float(_recording(motion)[0][-1])
    # Up to rounding, a frame at the end of the motion counts.
    count = math.floor(duration * scene.clocks.camera_hz + 1e-6) + 1
    if count > MOST_FRAMES:
        raise SceneError(
            f"the motion has {count:,} frames; at most {MOST_FRAMES:,} are possible: "
            f"{duration:g} s at clocks.camera_hz = {scene.clocks.camera_hz:g}. Shorten it."
        )
    return np.arange(count) / scene.clocks.camera_hz


def frame_times(scene: Scene, motion: Trajectory) -> NDArray[np.float64]:
    """Middle of each frame's exposure by the camera's clock, s."""
    jitter = np.random.default_rng([scene.clocks.seed, 1]).standard_normal(motion.moments.size)
    return motion.moments + scene.clocks.camera_jitter_s * jitter


def longest_exposure(scene: Scene) -> float:
    """Time between frames, s; infinite for a withdrawal, which may stop for each frame."""
    return math.inf if isinstance(scene.motion, Withdrawal) else 1 / scene.clocks.camera_hz


def kinematics(scene: Scene, motion: Trajectory) -> NDArray[np.float64]:
    """Poses that the robot reports: rows of time stamp, tip and axis.

    The time stamps are those of the robot's clock, which is ahead of the camera's by the offset,
    plus jitter. They never decrease. Distances from the first place are wrong as [rig_errors] says.

    Returns:
        n x 7: s, mm, unit vector; from 0.1 s before the first frame to 0.1 s after the last.
    """
    clocks = scene.clocks
    count = _pose_count(scene, motion.moments[-1])
    times = np.arange(count) / clocks.kinematics_hz - _MARGIN_S
    jitter = np.random.default_rng([scene.clocks.seed, 2]).standard_normal(count)
    wrong = scene.rig_errors.drawn()
    offset_s = clocks.kinematics_offset_s + wrong.clock_s
    stamps = times + offset_s + clocks.kinematics_jitter_s * jitter
    poses = motion.at(times)
    tip = poses.tip + wrong.robot_scale * (poses.tip - poses.tip[0])
    return np.column_stack([np.maximum.accumulate(stamps), tip, poses.axis])


def _pose_count(scene: Scene, last_s: float) -> int:
    rate_hz = scene.clocks.kinematics_hz
    count = math.ceil((last_s + 2 * _MARGIN_S) * rate_hz) + 1
    if count > _MAX_POSES:
        raise SceneError(
            f"the robot reports {count:,} poses; at most {_MAX_POSES:,} are possible: {last_s:g} "
            f"s at clocks.kinematics_hz = {rate_hz:g}. Raise the speed or lower kinematics_hz."
        )
    return count


def _withdrawal(geometry: SceneGeometry, motion: Withdrawal) -> PosesAt:
    spot, axis = geometry.aim
    start = motion.start_mm
    if isinstance(start, str):
        start = geometry.contact_distance

    def at(times: NDArray[np.float64]) -> Poses:
        distance = start + np.clip(motion.speed_mm_s * times, 0.0, motion.travel_mm)
        return Poses(spot - distance[:, None] * axis, np.broadcast_to(axis, (distance.size, 3)))

    return at


def _scan(geometry: SceneGeometry, motion: Scan) -> PosesAt:
    spot, axis = geometry.aim
    wall = geometry.wall
    outward, meridional, azimuthal = (np.asarray(v) for v in geometry.spot_frame[1:])
    direction = math.radians(motion.direction_deg)
    along = math.cos(direction) * meridional + math.sin(direction) * azimuthal

    def at(times: NDArray[np.float64]) -> Poses:
        gone = np.clip(motion.speed_mm_s * times, 0.0, motion.length_mm)
        path = (gone - motion.length_mm / 2)[:, None]
        if isinstance(wall, optics.Sphere):
            r = float(wall.radius)
            place = r * (np.cos(path / r) * outward + np.sin(path / r) * along)
        else:
            place = spot + path * along
            if isinstance(wall, optics.Ellipsoid):
                inside = place - float(wall.semi_axes[2]) * outward
                place = np.asarray(wall.intersect(inside, outward).point)
        pointing = _unit((place - spot) / motion.trocar_mm + axis)
        return Poses(place - motion.distance_mm * pointing, pointing)

    return at


def _hand(geometry: SceneGeometry, motion: Hand) -> PosesAt:
    spot, axis = geometry.aim
    rng = np.random.default_rng(motion.seed)
    damped_mm = (1 - motion.damping) * motion.tremor_rms_mm
    tremor = _BandLimitedMotion(rng, _TREMOR_HZ, rms=damped_mm)
    slow = _BandLimitedMotion(rng, _VOLUNTARY_HZ, rms=1.0)
    last = _moments(geometry.scene)[-1]
    fine = np.linspace(0.0, last, 1 + math.ceil(last / _SPEED_SEARCH_STEP_S))
    size = _scale_to_speed(slow.velocity(fine), tremor.velocity(fine), motion.top_speed_mm_s)
    home = spot - motion.distance_mm * axis
    lever = motion.trocar_mm - motion.distance_mm
    if lever <= 0:
        raise SceneError(
            f"motion.trocar_mm must exceed motion.distance_mm; got {motion.trocar_mm:g} mm with "
            f"{motion.distance_mm:g} mm. Raise trocar_mm."
        )

    def at(times: NDArray[np.float64]) -> Poses:
        aside = size * slow.position(times) + tremor.position(times)
        return Poses(home + aside, _unit(aside / lever + axis))

    return at


def _recorded(motion: Recorded) -> PosesAt:
    stamps, rows = _recording(motion)

    def at(times: NDArray[np.float64]) -> Poses:
        row = np.column_stack([np.interp(times, stamps, column) for column in rows.T])
        return Poses(row[:, :3], _unit(row[:, 3:]))

    return at


def _recording(motion: Recorded) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Times since the first pose, s, and rows of tip (mm) and axis."""
    with in_file("motion.file", SceneError):
        found = list(read_poses(Path(motion.file)))
    stamps = np.array([pose.time_s for pose in found])
    if len(found) < 2 or np.any(np.diff(stamps) <= 0):
        raise SceneError(
            f"motion.file: {motion.file} must contain at least two poses, with increasing time_s."
        )
    stamps -= stamps[0]
    return stamps, np.array([[*pose.position_mm, *pose.axis] for pose in found])


class _BandLimitedMotion:
    """Random motion in three dimensions: sinusoids with frequencies drawn evenly from a band.

    It is known exactly at any time. Its RMS is the root of the three coordinates' summed mean
    squares.
    """

    def __init__(
        self, rng: np.random.Generator, band_hz: tuple[float, float], *, rms: float
    ) -> None:
        self.rate = 2 * math.pi * rng.uniform(*band_hz, _SINUSOIDS_PER_BAND)  # rad/s
        cosine, sine = rng.standard_normal((2, _SINUSOIDS_PER_BAND, 3))
        size = rms / math.sqrt(np.sum(cosine**2 + sine**2) / 2)
        self.cosine, self.sine = size * cosine, size * sine  # n x 3, mm

    def position(self, times: NDArray[np.float64]) -> NDArray[np.float64]:
        phase = times[:, None] * self.rate
        return np.cos(phase) @ self.cosine + np.sin(phase) @ self.sine

    def velocity(self, times: NDArray[np.float64]) -> NDArray[np.float64]:
        phase = times[:, None] * self.rate
        return (np.cos(phase) * self.rate) @ self.sine - (np.sin(phase) * self.rate) @ self.cosine


def _scale_to_speed(
    slow: NDArray[np.float64], fast: NDArray[np.float64], top_speed: float
) -> float:
    """The factor g >= 0 at which |g slow + fast| peaks at the top speed."""
    own = np.linalg.norm(fast, axis=1).max()
    if own >= top_speed:
        raise SceneError(
            f"motion.top_speed_mm_s must exceed the speed of the tremor, {own:.2f} mm/s; got "
            f"{top_speed:g} mm/s. Raise it, or damping."
        )
    # At each time one g solves |g slow + fast|^2 = top^2; the smallest of these g counts.
    square, mixed = np.sum(slow**2, axis=1), np.sum(slow * fast, axis=1)
    rest = top_speed**2 - np.sum(fast**2, axis=1)
    return float(np.min((np.sqrt(mixed**2 + square * rest) - mixed) / square))


def _unit(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
