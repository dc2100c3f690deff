"""What a fit to pixels has: frames, spots, and the parameters that are free.

Frames are light with a known noise, with the conditions of the recording.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from eyespot import optics
from eyespot.calibration.spots.cone_trials import Prior
from eyespot.estimator.camera_noise import CameraNoise, camera_noise
from eyespot.estimator.distance.withdrawal import withdrawal_of
from eyespot.estimator.recording import Recording
from eyespot.formats.inputs import InputError
from eyespot.formats.microscope import MicroscopeFile
from eyespot.optics.instrument import BareFibre
from eyespot.optics.wall_light.lens_flux import PARAMETERS as LENS


@dataclass(frozen=True, kw_only=True, eq=False)
class Footage:
    """A withdrawal's frames as light.

    Attributes:
        light: mean of the channels, full wells, frames x h x w.
        clear: whether a pixel is neither black nor saturated in any channel.
        exposure_s: exposure times that the camera reports, or in proportion to them.
        readings: distance of the tip from its place in the first frame, mm.
        delayed, delay_s: of `ReportedWithdrawal`; None: the clocks are one.
        motion: unit vector against the tip's motion, towards the wall, reported by the robot.
        axis: unit vector along the tool from the tip towards the wall, reported by the robot.
        noise: the camera's noise.
        microscope: and wall, by the rig.
        instrument: the tool, which can hide the wall and touches it in the first frame.
        in_view: whether the instrument is visible.
        kind: kind of the wall, "eyeball" or "plane".
        medium_index: n0.
        touch_sigma: accuracy with which the contact was found, mm.
    """

    light: Float[np.ndarray, "frames h w"]
    clear: Bool[np.ndarray, "frames h w"]
    exposure_s: Float[np.ndarray, "frames"]
    readings: Float[np.ndarray, "frames"]
    motion: Float[np.ndarray, "3"]
    axis: Float[np.ndarray, "3"]
    noise: CameraNoise
    microscope: MicroscopeFile
    instrument: BareFibre
    in_view: bool
    kind: str
    medium_index: float
    touch_sigma: float = 0.02
    delayed: Float[np.ndarray, "frames delays"] | None = None
    delay_s: float = 1.0


def footage_of(source: Any) -> Footage:
    """Read the frames of a withdrawal as light.

    The camera's noise is that of the rig, or measured in the frames if the rig says nothing of it.

    Args:
        source: a recording, or what `Recording.open` takes.

    Raises:
        InputError: the rig lacks something, or robot poses that are no withdrawal or do not cover
            all frames.
    """
    recording = Recording.open(source)
    if recording.rig.view is not None and recording.rig.view.noise is None:
        recording = recording.measured()
    rig, view = recording.rig, recording.rig.view
    noise = None if view is None else camera_noise(view)
    if view is None or noise is None or rig.wall.medium is None:
        raise InputError(
            f"{recording.source.name}: a fit of pixels needs the microscope and wall.medium. Give "
            "--rig FILE; `eyespot rig init` writes one."
        )
    if view.distortion_model != "brown" or len(view.distortion) > _DISTORTION_COEFFICIENTS:
        raise InputError(
            f"{recording.source.name}: a fit of pixels takes out a distortion of OpenCV's first "
            f"{_DISTORTION_COEFFICIENTS} coefficients; this lens has {len(view.distortion)} "
            f"({view.distortion_model}). Undistort the images first, or fit the spots (--model "
            "cone)."
        )
    frames, instrument = list(recording.source), rig.instrument
    noise = noise.for_image(frames[0].image)
    times = np.array([frame.time_s for frame in frames])
    exposure_s = np.array([frame.exposure_s for frame in frames])
    known = exposure_s if np.isfinite(exposure_s).all() else None
    way = withdrawal_of(
        recording.robot(),
        times,
        robot=rig.robot,
        exposure_s=known,
        where=recording.source.name,
    )
    light = np.stack([noise.light(frame.image) for frame in frames]).astype(np.float32)
    return Footage(
        light=light,
        clear=np.stack([noise.is_within(frame.image) for frame in frames]),
        exposure_s=_relative_exposures(light, noise) if known is None else exposure_s,
        readings=way.readings,
        delayed=way.delayed,
        delay_s=way.delay_s,
        motion=way.motion,
        axis=way.axis,
        noise=noise,
        microscope=view,
        instrument=BareFibre(instrument.fibre_diameter_mm / 2, instrument.fibre_length_mm),
        in_view=instrument.visible,
        kind="eyeball" if view.plane_normal is None else "plane",
        medium_index=optics.MEDIA[rig.wall.medium],
        touch_sigma=rig.robot.touch_sigma_mm,
    )


_DISTORTION_COEFFICIENTS = 5  # k1, k2, p1, p2, k3: what the model of the light has
_SHOWN = 6.0
"""Noise of a pixel below which the background does not show how long a frame was exposed."""


def _relative_exposures(
    light: Float[np.ndarray, "frames h w"], noise: CameraNoise
) -> Float[np.ndarray, "frames"]:
    """Exposures by the light beside the beam, where the camera does not report them.

    The rest of a frame's gain is among its states. Without light beside the beam all are alike.
    """
    dim = np.quantile(light.reshape(len(light), -1), 0.2, axis=1)
    if dim.min() < _SHOWN * math.sqrt(float(noise.variance(np.zeros(())))):
        return np.ones(len(light))
    return dim / dim.mean()


UNITS = {
    "half_angle": "rad",
    "b": "mm",
    "blur": "px",
    "spread": "mm",
    "core_radius": "mm",
    "aperture_radius": "mm",
    "rim_height": "mm",
    "sag": "mm",
    "glue_index": "1",
    "numerical_aperture": "1",
    "scale": "mm/px",
    "eye_radius": "mm",
    "inverse_working_distance": "1/mm",
    "reflectance": "1",
    "power": "mW",
    "sensitivity": "mm2 sr/mJ",
    "illumination": "mW/mm2",
    "touch": "mm",
    "u": "px",
    "v": "px",
    "lean": "rad",
    "lean_sideways": "rad",
    "boresight": "rad",
    "boresight_sideways": "rad",
    "robot_scale": "1",
    "clock_offset": "s",
}
"""Every parameter's unit. `sensitivity`: full wells per radiance and second. `u`, `v`: image of
the point where the beam meets the wall at reading 0, in the first frame. `touch`: distance along
the beam there. `lean`, `lean_sideways`: rotation of the robot's directions against the eye, along
`optics.perpendicular_frame` of the tool's axis. `boresight`, `boresight_sideways`: angle of the
beam from the tool's axis, along the same vectors. `spread`: L of the light's spread in the wall
(`optics.spread_nodes`); without a start value there is none. `robot_scale`: true distances over the
robot's. `clock_offset`: by how much its clock is behind the camera's."""

CONE = ("half_angle", "b")
FREE = {"cone": CONE, "lens": ("sag", "numerical_aperture")}
"""Parameters that are free by default."""
POSE = (
    "touch",
    "u",
    "v",
    "lean",
    "lean_sideways",
    "boresight",
    "boresight_sideways",
    "robot_scale",
    "clock_offset",
)
"""Parameters of the frames' poses."""
_ANGLES = ("lean", "lean_sideways", "boresight", "boresight_sideways")
NUISANCES = ("sensitivity", "illumination", "touch", "u", "v", *_ANGLES)
"""Parameters that are free in every fit, because no log book contains them accurately enough."""
DEFAULTS = {"reflectance": 0.5, "power": 1.0, "sensitivity": 1.0, "robot_scale": 1.0}
DEFAULTS |= {"clock_offset": 0.0}
_MAY_BE_NEGATIVE = {"b", "illumination", "touch", "u", "v", *_ANGLES, "rim_height", "sag"}
_MAY_BE_NEGATIVE |= {"clock_offset", "inverse_working_distance"}
_MAX_HOLLOW = 0.01  # depth of a hollow end over its radius up to which the light is linear in it
_SUNK = 0.2
"""Depth of a rim below the core's face over its radius, to which noise may move a rim of height 0.
The light is linear in it."""
_MAX_RIM_CUT = 0.01  # by how much a rim may seem narrower than the core, relative: linear as well


def known_names(source: str) -> tuple[str, ...]:
    """Names of the parameters for the source "cone" or "lens"."""
    others = (*CONE, "blur") if source == "lens" else LENS
    return tuple(name for name in UNITS if name not in others)


def check_names(
    source: str, start: Mapping[str, float], free: Sequence[str], priors: Mapping[str, Prior]
) -> None:
    """Check the names of parameters.

    Raises:
        InputError: unknown names or missing start values.
    """
    own = CONE if source == "cone" else LENS
    names = known_names(source)
    unknown = [name for name in (*start, *free, *priors) if name not in names]
    missing = [name for name in own if name not in start]
    missing += [name for name in ("blur", "spread") if name in free and name not in start]
    if unknown or missing:
        raise InputError(
            f"the image fit of a {source} has the parameters {', '.join(names)} and needs start "
            f"values of {', '.join(own)}. Unknown: {', '.join(unknown) or 'none'}; missing: "
            f"{', '.join(missing) or 'none'}."
        )


def possible(values: Mapping[str, float]) -> bool:
    """Whether the parameters are physically possible; the solver rejects steps that are not.

    By the noise a flat end may seem hollow, and a rim narrower than the core that it encloses.
    """
    positive = all(value > 0 for name, value in values.items() if name not in _MAY_BE_NEGATIVE)
    lens = "sag" not in values or (
        -_MAX_HOLLOW * values["aperture_radius"] <= values["sag"] <= values["aperture_radius"]
        and values["aperture_radius"] >= (1.0 - _MAX_RIM_CUT) * values["core_radius"]
        and values["rim_height"] >= -_SUNK * values["aperture_radius"]
    )
    return positive and lens and values["reflectance"] < 1
