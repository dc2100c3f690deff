"""A recorded withdrawal as a trial: its spots, with the robot's readings and the tool's axis.

Spots come from the estimator, readings and axis from the robot, everything else from the rig.
"""

import hashlib
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike, Float

from eyespot import optics
from eyespot.calibration.spots.cone_trials import ConeTrial, Prior, phantom_wall
from eyespot.estimator import track_whole_source
from eyespot.estimator.recording import Recording
from eyespot.estimator.run.offline import MOST_ASIDE_MM
from eyespot.estimator.run.options import Options
from eyespot.formats.inputs import InputError
from eyespot.formats.manifest import MANIFEST
from eyespot.formats.microscope import MicroscopeFile
from eyespot.formats.poses import PoseTrack, Quaternion, turned
from eyespot.formats.rig import Rig, RobotKeys
from eyespot.formats.spots import Spot, SpotRecord

_MOST_ASKEW_DEG = 10.0
"""Largest angle between the tip's motion and the tool's axis: three standard deviations of
`BORESIGHT_SIGMA`. A larger angle is another motion, or the axis is given in another frame."""


def touch_of(
    kind: str,
    microscope: MicroscopeFile,
    spot: Float[ArrayLike, "2"],
    axis: Float[ArrayLike, "3"],
    *,
    rim_radius: float,
    tilt: tuple[float, float] = (0.0, 0.0),
    sigma: float,
) -> Prior:
    """Distance along the beam, mm, at which the tip's rim touches the wall, before its centre does.

    Args:
        spot: where the beam meets the wall, undistorted px.
        axis: unit vector along the tool towards the wall.
        sigma: accuracy with which the contact was found, mm.
    """
    wall = phantom_wall(kind, eye_radius=microscope.eye_radius_mm, tilt=tilt)
    normal = wall.intersect(*microscope.ideal_microscope().ray(spot)).normal
    incidence = jnp.arccos(-normal @ axis)
    contact = optics.contact_distance(wall, incidence=incidence, rim_radius=rim_radius)
    return Prior(float(contact), sigma)


_PARTS = 32  # of an exposure, in whose middles the place is averaged


def withdrawal(
    times: Float[np.ndarray, "n"],
    poses: PoseTrack,
    *,
    source: str,
    exposure_s: Float[np.ndarray, "n"] | None = None,
) -> tuple[
    Float[np.ndarray, "n"],
    Float[np.ndarray, "3"],
    Float[np.ndarray, "3"],
    Float[np.ndarray, "2 3"],
]:
    """Distance of the tip since the first frame, its direction, and the tool's mean axes.

    Positions are interpolated between poses: at 0.1 mm/s and 200 Hz the latest pose lags by up to
    0.5 um, which equals one standard error of the half-angle at 5 mm. They are means over the
    exposures: a robot that stops in the middle of one is 1 um behind at 0.1 mm/s and 0.1 s.

    Args:
        times: times of the frames, in the middle of their exposures, s, on the poses' clock.
        poses: the robot's.
        source: source of the frames, for messages.
        exposure_s: of the frames; None if they are not known.

    Returns:
        Distances from the first frame along the motion, mm, and unit vectors in the poses' frame:
        the motion, reversed, and the tool's axis, both towards the wall, and the tool's x and y
        axes in the middle of the withdrawal.

    Raises:
        InputError: poses that cannot be read or do not cover the frames, or no withdrawal.
    """
    known = np.array([pose.time_s for pose in poses])
    # An unknown time is NaN, for which these comparisons are false.
    if not (known[0] <= times.min() and times.max() <= known[-1]):
        raise InputError(
            f"the robot's poses go from {known[0]:.3f} to {known[-1]:.3f} s, but the frames of "
            f"{source} from {times.min():.3f} to {times.max():.3f} s. Record the poses on the "
            "frames' clock, from before the first frame until after the last; images without times "
            "need frames.csv beside them (file,time_s) or --fps."
        )
    reported = np.array([pose.position_mm for pose in poses])
    parts = np.zeros((times.size, 1))
    if exposure_s is not None:
        parts = exposure_s[:, None] * ((np.arange(_PARTS) + 0.5) / _PARTS - 0.5)
    moments = times[:, None] + parts
    places = np.stack([np.interp(moments, known, x).mean(axis=1) for x in reported.T], axis=1)
    # Use all poses between which the frames lie, even if they are only two.
    first = int(np.searchsorted(known, times.min(), side="right")) - 1
    last = int(np.searchsorted(known, times.max(), side="left"))
    every = list(poses)
    axis = np.mean([pose.axis for pose in every[first : last + 1]], axis=0)
    axis /= np.linalg.norm(axis)
    gone = places[0] - places
    _, travel, lines = np.linalg.svd(gone - gone.mean(axis=0), full_matrices=False)
    # A tip at rest has no direction.
    motion = lines[0] if travel[0] > MOST_ASIDE_MM else axis
    motion = np.asarray(motion * np.copysign(1.0, motion @ axis))
    readings = gone @ motion
    aside = np.linalg.norm(gone - readings[:, None] * motion, axis=1).max()
    askew = math.degrees(math.acos(min(float(motion @ axis), 1.0)))
    if aside > MOST_ASIDE_MM or askew > _MOST_ASKEW_DEG:
        raise InputError(
            f"{source} is no withdrawal: the tip leaves a straight line by {aside:.2f} mm, and the "
            f"line is {askew:.1f}° from the tool's axis; {MOST_ASIDE_MM} mm and "
            f"{_MOST_ASKEW_DEG:g}° are allowed. Withdraw the tip along its axis, one spot a trial."
        )
    middle = every[(first + last) // 2].rotation
    across = np.array([turned(side, middle) for side in ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0))])
    return readings, motion, axis, across


_FEWEST_SPOTS = 3
_LEAST_COVERAGE = 0.5
"""Least visible fraction of the contour; below it, the ellipse depends mainly on the model."""


class RecordedTrial(NamedTuple):
    """A withdrawal, ready to be fitted.

    Attributes:
        recording: the frames, poses and rig, whose name it has.
        trial: spots, readings and axis.
        tilt: tilt of the plane.
        across: unit vectors of the tool's x and y axes, eye frame.
        frames: number of frames, with or without a usable spot.
        fibre_radius_mm: half the diameter of the tip's face.
        sha256: checksum of a stack's manifest, which contains those of all its files; otherwise of
            the files, or of frames in memory.
        records: of the usable spots, as they were measured.
    """

    name: str
    recording: Recording
    trial: ConeTrial
    tilt: tuple[float, float]
    across: Float[np.ndarray, "2 3"]
    frames: int
    microscope: MicroscopeFile
    medium: str
    fibre_radius_mm: float
    sha256: str
    records: Sequence[SpotRecord] = ()

    @property
    def beam_slopes(self) -> Float[np.ndarray, "2 2"]:
        """Derivatives of (beam_x, beam_y) of a calibration with respect to the boresight."""
        return self.across @ np.stack(optics.perpendicular_frame(self.trial.axis)).T


FREE_TOUCH = Prior(3.0, 10.0)
"""Of a first frame whose distance nobody states: anything that fits into an eye."""


def recorded_trial(
    source: Any,
    *,
    touch: Prior | None = None,
    progress: Callable[[], None] = lambda: None,
) -> RecordedTrial:
    """Measure or read the spots of a withdrawal and join them with the robot's poses.

    Readings are distances from the first frame along the motion that the robot reports.

    Args:
        source: a recording, or what `Recording.open` takes.
        touch: distance at the first frame, mm; None: as the rig states it.
        progress: called after each measured frame.

    Raises:
        InputError: the rig lacks something, no withdrawal, or too few spots.
    """
    recording = Recording.open(source)
    rig, name = recording.rig, recording.source.name
    medium, turn = _known(rig, recording)
    view = rig.view
    if view is None:
        raise InputError(
            f"{name}: the fit needs the microscope. Give --rig FILE; `eyespot rig init` writes one."
        )
    kind = rig.wall.kind or ("eyeball" if view.plane_normal is None else "plane")
    x, y, z = view.plane_normal or (0.0, 0.0, 1.0)
    tilt = (x / z, y / z) if kind == "plane" else (0.0, 0.0)
    records = recording.spots
    if records is None:
        reader = Options(mode="subpixel").reader(rig)
        still = Recording(recording.source, rig=rig)  # spots do not depend on poses
        records = track_whole_source(still, reader, progress=lambda record: progress())
    times = np.array([record.time_s for record in records])
    readings, *directions = withdrawal(times, recording.robot(), source=name)
    motion, axis, *across = (
        np.array(turned(tuple(direction), turn)) for direction in np.vstack(directions)
    )
    usable = [
        (record, record.result, reading)
        for record, reading in zip(records, readings, strict=True)
        # The coverage is NaN in modes that do not measure it.
        if isinstance(record.result, Spot) and not record.result.coverage < _LEAST_COVERAGE
    ]
    if len(usable) < _FEWEST_SPOTS:
        raise InputError(
            f"{name} has {len(usable)} usable spots in {len(records)} frames; a fit needs "
            f"{_FEWEST_SPOTS}. `eyespot track {name} --out spots.csv` shows the reasons."
        )
    spots = [spot for _, spot, _ in usable]
    columns = jnp.array([spot.ellipse for spot in spots])
    ellipses = optics.Ellipse(columns[:, :2], *columns[:, 2:].T)
    rim = rig.instrument.fibre_diameter_mm / 2
    if touch is None:
        touch = _stated_touch(rig.robot)
    if touch is None:
        where = ellipses.centre[0], axis
        sigma = rig.robot.touch_sigma_mm
        touch = touch_of(kind, view, *where, rim_radius=rim, tilt=tilt, sigma=sigma)
    return RecordedTrial(
        name=recording.name,
        recording=recording,
        trial=ConeTrial(
            ellipses=ellipses,
            covariances=np.stack([spot.covariance for spot in spots]),
            coverage=np.nan_to_num([spot.coverage for spot in spots], nan=1.0),
            readings=np.array([reading for _, _, reading in usable]),
            motion=motion,
            axis=axis,
            principal_point=np.array(view.principal_point_px),
            touch=touch,
            kind=kind,
        ),
        tilt=tilt,
        across=np.stack(across),
        frames=len(records),
        microscope=view,
        medium=medium,
        fibre_radius_mm=rim,
        sha256=_sha256(recording),
        records=[record for record, _, _ in usable],
    )


def _known(rig: Rig, recording: Recording) -> tuple[str, Quaternion]:
    """What a fit cannot do without: the medium, and the robot's frame."""
    wall, turn = rig.wall, rig.robot.eye_from_robot
    if wall.medium is None or turn is None:
        missing = "wall.medium" if wall.medium is None else "robot.eye_from_robot"
        raise InputError(
            f"{recording.source.name}: {missing} is not stated. Write it into the rig file (--rig "
            f"FILE), or give --set {missing}=VALUE."
        )
    return wall.medium, turn


def _stated_touch(robot: RobotKeys) -> Prior | None:
    """The distance in the first frame that the rig states; None at contact."""
    if robot.touch == "contact":
        return None
    return FREE_TOUCH if robot.touch == "free" else Prior(*robot.touch)


def _sha256(recording: Recording) -> str:
    """Checksum of a stack's manifest, of the files, or of frames in memory."""
    path = Path(recording.source.name)
    checksum = hashlib.sha256()
    if (path / MANIFEST).is_file():
        files = [path / MANIFEST]
    elif path.is_dir():
        files = sorted(one for one in path.rglob("*") if one.is_file())
    elif path.is_file():
        files = [path]
    else:
        for frame in recording.source:
            checksum.update(np.ascontiguousarray(frame.image).tobytes())
        return checksum.hexdigest()
    for file in files:
        with file.open("rb") as content:
            checksum.update(hashlib.file_digest(content, "sha256").digest())
    return checksum.hexdigest()
