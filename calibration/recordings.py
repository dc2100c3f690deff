"""Recordings as trials: withdrawals of stacks, spots files and bags with the robot's readings.

Spots come from the estimator, readings and axis from the robot. From a stack's labels only each
frame's time is read, so a fit uses only what a real rig has. The rest would be in a rig's log book:
the wall's kind and tilt, the medium, the fibre's diameter, and whether the withdrawal began at the
touch.
"""

import hashlib
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike, Float

from eyespot import optics
from eyespot.calibration.spots.cone_trials import ConeTrial, Prior, phantom_wall
from eyespot.estimator import track_whole_source
from eyespot.estimator.run.offline import MOST_ASIDE_MM
from eyespot.estimator.run.options import Options
from eyespot.estimator.sources.opening import open_source
from eyespot.formats.inputs import InputError, shortened
from eyespot.formats.microscope import MicroscopeFile, read_microscope
from eyespot.formats.poses import Quaternion, read_poses, turned
from eyespot.formats.spots import Spot, SpotRecord, read_spots
from eyespot.formats.stack import Stack, read_stack

_MOST_ASKEW_DEG = 10.0
"""Largest angle between the tip's motion and the tool's axis: three standard deviations of
`BORESIGHT_SIGMA`. A larger angle is another motion, or the axis is given in another frame."""


_TOUCH_SIGMA_MM = 0.02
"""Accuracy with which an operator finds the contact; the paper's own trials scatter more."""


def touch_of(
    kind: str,
    microscope: MicroscopeFile,
    spot: Float[ArrayLike, "2"],
    axis: Float[ArrayLike, "3"],
    *,
    rim_radius: float,
    tilt: tuple[float, float] = (0.0, 0.0),
) -> Prior:
    """Distance along the beam, mm, at which the tip's rim touches the wall, before its centre does.

    Args:
        spot: where the beam meets the wall, undistorted px.
        axis: unit vector along the tool towards the wall.
    """
    wall = phantom_wall(kind, eye_radius=microscope.eye_radius_mm, tilt=tilt)
    normal = wall.intersect(*microscope.ideal_microscope().ray(spot)).normal
    incidence = jnp.arccos(-normal @ axis)
    contact = optics.contact_distance(wall, incidence=incidence, rim_radius=rim_radius)
    return Prior(float(contact), _TOUCH_SIGMA_MM)


_PARTS = 32  # of an exposure, in whose middles the place is averaged


def withdrawal(
    times: Float[np.ndarray, "n"],
    poses_file: Path,
    *,
    source: Path,
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
        poses_file: see `read_poses`.
        source: source of the frames, for messages.
        exposure_s: of the frames; None if they are not known.

    Returns:
        Distances from the first frame along the motion, mm, and unit vectors in the poses' frame:
        the motion, reversed, and the tool's axis, both towards the wall, and the tool's x and y
        axes in the middle of the withdrawal.

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
    parts = np.zeros((times.size, 1))
    if exposure_s is not None:
        parts = exposure_s[:, None] * ((np.arange(_PARTS) + 0.5) / _PARTS - 0.5)
    moments = times[:, None] + parts
    places = np.stack([np.interp(moments, known, x).mean(axis=1) for x in reported.T], axis=1)
    # Use all poses between which the frames lie, even if they are only two.
    first = np.searchsorted(known, times.min(), side="right") - 1
    last = np.searchsorted(known, times.max(), side="left")
    axis = np.mean([pose.axis for pose in poses[first : last + 1]], axis=0)
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
    middle = poses[(first + last) // 2].rotation
    across = np.array([turned(side, middle) for side in ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0))])
    return readings, motion, axis, across


_FEWEST_SPOTS = 3
_LEAST_COVERAGE = 0.5
"""Least visible fraction of the contour; below it, the ellipse depends mainly on the model."""
SPOTS_FILES = (".csv", ".parquet")
"""Endings of files of spots, without images."""


@dataclass(frozen=True, kw_only=True)
class LogBook:
    """The conditions of a recording. A stack contains them; for other recordings the user does.

    Attributes:
        kind: kind of the wall, as in `ConeTrial.kind`.
        tilt: tilt of the plane, as in `phantom_wall`.
        medium: medium between the tip and the wall, a name in `optics.MEDIA`.
        fibre_diameter_mm: diameter of the tip's face, whose rim touches first.
        microscope: file, see `read_microscope`.
        poses: file, see `read_poses`.
        eye_from_robot: unit quaternion that turns the poses' frame into the eye's.
        begins_at_touch: whether the first frame was taken when the tip touched the wall.
    """

    kind: str
    medium: str
    fibre_diameter_mm: float
    microscope: Path
    poses: Path
    tilt: tuple[float, float] = (0.0, 0.0)
    eye_from_robot: Quaternion = (0.0, 0.0, 0.0, 1.0)
    begins_at_touch: bool = True


class Recording(NamedTuple):
    """A withdrawal, ready to be fitted.

    Attributes:
        source: its file or folder, whose name it has.
        trial: spots, readings and axis.
        tilt: tilt of the plane, from the log book.
        across: unit vectors of the tool's x and y axes, eye frame.
        frames: number of frames, with or without a usable spot.
        fibre_radius_mm: half the diameter of the tip's face.
        sha256: checksum of a stack's manifest, which contains the checksums of all its files;
            otherwise of the files read.
        records: of the usable spots, as they were measured.
    """

    name: str
    source: Path
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


def is_stack(source: Path) -> bool:
    """Whether a source is a stack, which contains its own log book."""
    return (source / "stack.toml").is_file()


def read_recording(
    source: Path,
    *,
    exposure: str | None = None,
    log_book: LogBook | None = None,
    touch: Prior | None = None,
    progress: Callable[[], None] = lambda: None,
) -> Recording:
    """Measure or read the spots of a withdrawal and join them with the robot's poses.

    Readings are distances from the first frame along the motion that the robot reports.

    Args:
        source: a stack, a spots file, or any other source of `open_source`, such as a bag or video.
        exposure: see `open_source`.
        log_book: for a source other than a stack, which contains its own.
        touch: distance at the first frame, mm; by default the distance at which the rim touches.
        progress: called after each measured frame.

    Raises:
        InputError: a missing or broken file, no withdrawal from the touch, or too few spots.
    """
    source = Path(source)
    if log_book is None and not source.is_dir():
        raise InputError(f"{source} is no stack, so the fit needs a log book. Give log_book.")
    if log_book is None or is_stack(source):
        log_book, prints = _of_stack(source), [source / "manifest.json"]
    else:
        prints = [source, log_book.poses]
    if source.suffix.lower() in SPOTS_FILES:
        records = read_spots(source)
    else:
        opened = open_source(source, exposure=exposure)
        reader = Options(microscope=log_book.microscope).reader()
        records = track_whole_source(opened, reader, progress=lambda record: progress())
    if touch is None and not log_book.begins_at_touch:
        raise InputError(
            f"{source} does not begin where the tip touches the wall, so the distance at reading 0 "
            "is unknown. Give the first frame's distance in mm, --prior touch=MEAN,SIGMA, "
            "or start at contact."
        )
    times = np.array([record.time_s for record in records])
    readings, *directions = withdrawal(times, log_book.poses, source=source)
    motion, axis, *across = (
        np.array(turned(tuple(direction), log_book.eye_from_robot))
        for direction in np.vstack(directions)
    )
    usable = [
        (record, record.result, reading)
        for record, reading in zip(records, readings, strict=True)
        # The coverage is NaN in modes that do not measure it.
        if isinstance(record.result, Spot) and not record.result.coverage < _LEAST_COVERAGE
    ]
    if len(usable) < _FEWEST_SPOTS:
        raise InputError(
            f"{source} has {len(usable)} usable spots in {len(records)} frames; a fit needs "
            f"{_FEWEST_SPOTS}. `eyespot track {source} --out spots.csv` shows the reasons."
        )
    spots = [spot for _, spot, _ in usable]
    microscope = read_microscope(log_book.microscope)
    columns = jnp.array([spot.ellipse for spot in spots])
    ellipses = optics.Ellipse(columns[:, :2], *columns[:, 2:].T)
    rim = log_book.fibre_diameter_mm / 2
    if touch is None:
        where = ellipses.centre[0], axis
        touch = touch_of(log_book.kind, microscope, *where, rim_radius=rim, tilt=log_book.tilt)
    return Recording(
        name=source.name,
        source=source,
        trial=ConeTrial(
            ellipses=ellipses,
            covariances=np.stack([spot.covariance for spot in spots]),
            coverage=np.nan_to_num([spot.coverage for spot in spots], nan=1.0),
            readings=np.array([reading for _, _, reading in usable]),
            motion=motion,
            axis=axis,
            principal_point=np.array(microscope.principal_point_px),
            touch=touch,
            kind=log_book.kind,
        ),
        tilt=log_book.tilt,
        across=np.stack(across),
        frames=len(records),
        microscope=microscope,
        medium=log_book.medium,
        fibre_radius_mm=rim,
        sha256=_sha256(prints),
        records=[record for record, _, _ in usable],
    )


def _of_stack(folder: Path) -> LogBook:
    stack = read_stack(folder)

    def number(key: str) -> float:
        return stack.described(f"scene.{key}", float)

    tilt, towards = (math.radians(number(f"phantom.tilt_{part}deg")) for part in ("", "azimuth_"))
    motion: dict[str, object] = stack.described("scene.motion", dict)
    return LogBook(
        kind=_one_of(stack, "scene.phantom.kind", ("eyeball", "plane")),
        tilt=(math.tan(tilt) * math.cos(towards), math.tan(tilt) * math.sin(towards)),
        medium=_one_of(stack, "scene.source.medium", tuple(optics.MEDIA)),
        fibre_diameter_mm=2 * stack_tip_radius(stack),
        microscope=folder / "microscope.json",
        poses=folder / "kinematics.csv",
        begins_at_touch=(motion.get("kind"), motion.get("start_mm")) == ("withdrawal", "contact"),
    )


def stack_tip_radius(stack: Stack) -> float:
    """Radius of the rim that touched the wall first, mm."""
    fibre = stack.described("scene.instrument.fibre_diameter_mm", float)
    if stack.described("scene.source.kind", str) != "cone":
        return fibre / 2
    cone = {key: stack.described(f"cone.{key}", float) for key in ("half_angle", "apex_offset")}
    return optics.tip_radius(fibre_diameter=fibre, **cone)


def _one_of(stack: Stack, key: str, known: tuple[str, ...]) -> str:
    found = stack.described(key, str)
    if found not in known:
        raise InputError(
            f"{stack.folder / 'stack.toml'}: {key} must be one of {', '.join(known)}; got "
            f"{shortened(found)}. Render the stack again."
        )
    return found


def _sha256(paths: Iterable[Path]) -> str:
    """Checksum of files, or of all files in folders."""
    checksum = hashlib.sha256()
    for path in paths:
        for file in sorted(p for p in path.rglob("*") if p.is_file()) if path.is_dir() else [path]:
            with file.open("rb") as content:
                checksum.update(hashlib.file_digest(content, "sha256").digest())
    return checksum.hexdigest()
