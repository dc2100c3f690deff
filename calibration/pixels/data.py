"""What a fit to pixels has: frames, spots, and the parameters that are free.

Frames are light with a known noise, with the conditions of the recording. Reads images, times,
exposures, the robot's poses and the microscope's file. From the scene it reads only the camera's
data sheet, the wall's kind, the medium and the instrument's sizes. It does not read the labels.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from eyespot import optics
from eyespot.calibration.recordings import stack_tip_radius, withdrawal
from eyespot.calibration.spots.cone_trials import Prior
from eyespot.estimator.sources.opening import open_source
from eyespot.formats.camera import CameraNoise, CameraSheet, Response
from eyespot.formats.inputs import InputError, in_file, shortened, validated
from eyespot.formats.microscope import MicroscopeFile, read_microscope
from eyespot.formats.stack import Stack
from eyespot.optics.instrument import BareFibre
from eyespot.optics.wall_light.lens import PARAMETERS as LENS


@dataclass(frozen=True, kw_only=True, eq=False)
class Footage:
    """A withdrawal's frames as light.

    Attributes:
        light: mean of the channels, full wells, frames x h x w.
        clear: whether a pixel is neither black nor saturated in any channel.
        exposure_s: exposure times that the camera reports.
        readings: distance of the tip from its place in the first frame, mm.
        motion: unit vector against the tip's motion, towards the wall, reported by the robot.
        axis: unit vector along the tool from the tip towards the wall, reported by the robot.
        noise: the camera's noise.
        microscope: the stack's microscope file.
        instrument: the tool, which can hide the wall.
        tip_radius: of the rim that touched the wall first, mm.
        in_view: whether the instrument is visible.
        kind: kind of the wall, "eyeball" or "plane".
        medium_index: n0.
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
    tip_radius: float
    in_view: bool
    kind: str
    medium_index: float


def read_footage(stack: Stack, *, exposure: str | None = None) -> Footage:
    """Read a stack's frames as light.

    Args:
        stack: a withdrawal that begins at contact.
        exposure: see `open_source`.

    Raises:
        InputError: a camera that the noise model does not support, or robot
            poses that are no withdrawal or do not cover all frames.
    """
    microscope = read_microscope(stack.folder / "microscope.json")
    camera = stack.described("scene.camera", dict)
    with in_file(stack.folder / "stack.toml"):
        noise = noise_of(camera, microscope.response)
    frames = list(open_source(stack.folder, exposure=exposure))
    times = np.array([frame.time_s for frame in frames])
    exposure_s = np.array([frame.exposure_s for frame in frames])
    readings, motion, axis, _ = withdrawal(
        times, stack.folder / "kinematics.csv", source=stack.folder, exposure_s=exposure_s
    )

    def number(key: str) -> float:
        return stack.described(f"scene.{key}", float)

    medium = stack.described("scene.source.medium", str)
    if medium not in optics.MEDIA:
        raise InputError(f"{stack.folder}: unknown medium {shortened(medium)}. Render it again.")
    return Footage(
        light=np.stack([noise.light(frame.image) for frame in frames]).astype(np.float32),
        clear=np.stack(
            [((f.image > 0) & (f.image < noise.full_scale)).all(axis=-1) for f in frames]
        ),
        exposure_s=exposure_s,
        readings=readings,
        motion=motion,
        axis=axis,
        noise=noise,
        microscope=microscope,
        instrument=BareFibre(
            number("instrument.fibre_diameter_mm") / 2, number("instrument.fibre_length_mm")
        ),
        tip_radius=stack_tip_radius(stack),
        in_view=stack.described("scene.instrument.visible", bool),
        kind=stack.described("scene.phantom.kind", str),
        medium_index=optics.MEDIA[medium],
    )


def noise_of(camera: dict[str, Any], response: Response) -> CameraNoise:
    """The noise of the table [camera] of a scene.

    Raises:
        InputError: the camera correlates the noise of pixels or has fixed-pattern noise, or the
            table is damaged.
    """
    correlating = ("bayer", "jpeg_quality", "prnu", "dsnu_e")
    names = ", ".join(
        f"{k} = {camera[k]}" for k in correlating if camera.get(k, 0) not in ("none", 0)
    )
    if names:
        raise InputError(
            f"the image fit needs independent noise in every pixel; this camera has {names}. "
            "Record raw frames, divided by a flat field, or fit the spots (--model cone)."
        )
    own = CameraSheet.model_fields.keys() & camera.keys() - {"bayer"}
    sheet = {name: camera[name] for name in own}
    return CameraNoise(validated(CameraSheet, sheet, remedy="Render the stack again."), response)


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
}
"""Every parameter's unit. `sensitivity`: full wells per radiance and second. `u`, `v`: image of
the point where the beam meets the wall at reading 0, in the first frame. `touch`: distance along
the beam there. `lean`, `lean_sideways`: rotation of the robot's directions against the eye, along
`optics.perpendicular_frame` of the tool's axis. `boresight`, `boresight_sideways`: angle of the
beam from the tool's axis, along the same vectors. `spread`: L of the light's spread in the wall
(`optics.spread_nodes`); without a start value there is none. `robot_scale`: true distances over the
robot's."""

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
)
"""Parameters of the frames' poses."""
_ANGLES = ("lean", "lean_sideways", "boresight", "boresight_sideways")
NUISANCES = ("sensitivity", "illumination", "touch", "u", "v", *_ANGLES)
"""Parameters that are free in every fit, because no log book contains them accurately enough."""
DEFAULTS = {"reflectance": 0.5, "power": 1.0, "sensitivity": 1.0, "robot_scale": 1.0}
_MAY_BE_NEGATIVE = {"b", "illumination", "touch", "u", "v", *_ANGLES, "rim_height", "sag"}
_HOLLOW = 0.01  # depth of a hollow end over its radius up to which the light is linear in it
_CUT = 0.01  # by how much a rim may seem narrower than the core, relative: linear as well


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
        -_HOLLOW * values["aperture_radius"] <= values["sag"] <= values["aperture_radius"]
        and values["aperture_radius"] >= (1.0 - _CUT) * values["core_radius"]
        and values["rim_height"] >= 0
    )
    return positive and lens and values["reflectance"] < 1
