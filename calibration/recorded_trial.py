"""A recorded withdrawal as a trial: its spots, with the robot's readings and the tool's axis.

Spots come from the estimator, readings and axis from the robot, everything else from the rig.
"""

import hashlib
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike, Float

from eyespot import optics
from eyespot.calibration.spots.cone_trials import ConeTrial, Prior, phantom_wall
from eyespot.estimator import track_whole_source
from eyespot.estimator.distance.cone_range import unblurred
from eyespot.estimator.distance.withdrawal import withdrawal_of
from eyespot.estimator.ghost import Ghost
from eyespot.estimator.recording import Recording
from eyespot.estimator.run.options import Options
from eyespot.estimator.run.reader import SubpixelMode
from eyespot.estimator.sources.source import Frame
from eyespot.formats.inputs import InputError, in_file
from eyespot.formats.manifest import MANIFEST
from eyespot.formats.microscope import MicroscopeFile
from eyespot.formats.poses import Quaternion, RobotKeys, turned
from eyespot.formats.rig import Rig
from eyespot.formats.spot import Spot
from eyespot.formats.spots import SpotRecord

NO_LAYER = Prior(0.0, 0.0)


def touch_of(
    kind: str,
    microscope: MicroscopeFile,
    spot: Float[ArrayLike, "2"],
    axis: Float[ArrayLike, "3"],
    *,
    rim_radius: float,
    tilt: tuple[float, float] = (0.0, 0.0),
    layer: Prior = NO_LAYER,
    sigma: float,
) -> Prior:
    """Distance along the beam, mm, at which the tip's rim touches the wall, before its centre does.

    Args:
        spot: where the beam meets the wall, undistorted px.
        axis: unit vector along the tool towards the wall.
        layer: thickness of a clear layer over the wall, which the rim touches first, mm.
        sigma: accuracy with which the contact was found, mm.
    """
    wall = phantom_wall(kind, eye_radius=microscope.eye_radius_mm, tilt=tilt)
    normal = wall.intersect(*microscope.ideal_microscope().ray(spot)).normal
    incidence = jnp.arccos(-normal @ axis)
    contact = optics.contact_distance(wall, incidence=incidence, rim_radius=rim_radius)
    longer = 1.0 / float(jnp.cos(incidence))  # the layer's refraction is 3 um at 30 degrees
    return Prior(float(contact) + longer * layer.mean, math.hypot(sigma, longer * layer.sigma))


_FEWEST_SPOTS = 3
_LEAST_COVERAGE = 0.6
"""Least visible fraction of the contour. Below it the mismatch of rendered spots with the truth has
twice the variance that they state, up to five times at contact; from it to 0.8, 1.1 times."""


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
        ghost: of sharp spots, the strongest that was found.
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
    ghost: Ghost | None = None

    @property
    def beam_slopes(self) -> Float[np.ndarray, "2 2"]:
        """Derivatives of (beam_x, beam_y) of a calibration with respect to the boresight."""
        return self.across @ np.stack(optics.perpendicular_frame(self.trial.axis)).T

    @property
    def sharp_trial(self) -> ConeTrial:
        """The trial with the contours that a sharp cone has before its light is blurred."""
        spots = [unblurred(one.result) for one in self.records if isinstance(one.result, Spot)]
        if not spots:
            return self.trial
        covariances = np.stack([spot.covariance for spot in spots])
        return replace(self.trial, ellipses=_ellipses(spots), covariances=covariances)

    def only(self, spots: "np.ndarray") -> "RecordedTrial":
        """The recording with some of its usable spots, by their numbers."""
        own = self.trial
        trial = replace(
            own,
            ellipses=optics.Ellipse(*(leaf[spots] for leaf in own.ellipses)),
            covariances=own.covariances[spots],
            coverage=own.coverage[spots],
            readings=own.readings[spots],
            delayed=None if own.delayed is None else own.delayed[spots],
        )
        records = [self.records[k] for k in spots] if self.records else ()
        return self._replace(trial=trial, records=records)


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
    records, ghost = recording.spots, None
    exposures: list[float] = []
    if records is None:

        def frames() -> Iterator[Frame]:
            for frame in recording.source:
                exposures.append(frame.exposure_s)
                yield frame

        reader = Options(mode="subpixel").reader(rig)
        assert isinstance(reader, SubpixelMode)
        # Spots do not depend on poses.
        still = Recording(replace(recording.source, read=frames), rig=rig)
        records = track_whole_source(still, reader, progress=lambda record: progress())
        ghost = reader.ghosts.strongest
    times = np.array([record.time_s for record in records])
    robot = rig.robot
    if touch is not None:  # known from elsewhere, so the recording may begin anywhere
        robot = robot.model_copy(update={"touch": tuple(touch)})
    known = bool(exposures) and bool(np.isfinite(exposures).all())
    way = withdrawal_of(
        recording.robot(),
        times,
        robot=robot,
        exposure_s=np.array(exposures) if known else None,
        where=name,
    )
    motion, axis, *across = (
        np.array(turned(tuple(direction), turn))
        for direction in (way.motion, way.axis, *way.across)
    )
    usable = [
        number
        for number, record in enumerate(records)
        # The coverage is NaN in modes that do not measure it.
        if isinstance(record.result, Spot) and not record.result.coverage < _LEAST_COVERAGE
    ]
    if len(usable) < _FEWEST_SPOTS:
        raise InputError(
            f"{name} has {len(usable)} usable spots in {len(records)} frames; a fit needs "
            f"{_FEWEST_SPOTS}. `eyespot track {name} --out spots.csv` shows the reasons."
        )
    spots = [spot for number in usable if isinstance(spot := records[number].result, Spot)]
    ellipses = _ellipses(spots)
    with in_file(name):
        view.require_wall_at(np.asarray(ellipses.centre))
    rim = rig.instrument.fibre_diameter_mm / 2
    if touch is None:
        touch = _stated_touch(rig.robot)
    if touch is None:
        where = ellipses.centre[0], axis
        stated, sigma = rig.stated, rig.robot.touch_sigma_mm
        layer = Prior(stated.clear_layer_mm, stated.clear_layer_sigma_mm)
        touch = touch_of(kind, view, *where, rim_radius=rim, tilt=tilt, layer=layer, sigma=sigma)
    return RecordedTrial(
        name=recording.name,
        recording=recording,
        trial=ConeTrial(
            ellipses=ellipses,
            covariances=np.stack([spot.covariance for spot in spots]),
            coverage=np.nan_to_num([spot.coverage for spot in spots], nan=1.0),
            readings=way.readings[usable],
            delayed=way.delayed[usable],
            delay_s=way.delay_s,
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
        records=[records[number] for number in usable],
        ghost=ghost,
    )


def _ellipses(spots: Sequence[Spot]) -> optics.Ellipse:
    columns = jnp.array([spot.ellipse for spot in spots])
    return optics.Ellipse(columns[:, :2], *columns[:, 2:].T)


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
