"""The options of a measurement, defined once for the commands and for the rig's node."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

import numpy as np
from cyclopts import Group, Parameter
from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    FiniteFloat,
    TypeAdapter,
    ValidationError,
)

from eyespot.estimator.run.exit_codes import option
from eyespot.estimator.run.progress_bar import say
from eyespot.formats.inputs import InputError, shortened
from eyespot.formats.poses import Quaternion, unit_quaternion

if TYPE_CHECKING:
    from eyespot.estimator.detector.literal import LiteralSettings
    from eyespot.estimator.detector.settings import SubpixelSettings
    from eyespot.estimator.run.reader import Reader
    from eyespot.estimator.sources.source import Source
    from eyespot.formats.calibration import Calibration
    from eyespot.formats.microscope import MicroscopeFile
    from eyespot.formats.poses import PoseTrack
    from eyespot.formats.stated import Stated

_NEEDS = {
    **dict.fromkeys(("pinhole_height_mm", "eye_radius_mm", "wall", "calibration"), "microscope"),
    **dict.fromkeys(
        ("model", "eccentricity_mm", "exposure_s", "eye_from_robot", "stated"), "calibration"
    ),
}

DistanceModel = Literal[
    "planar", "small_plane", "corrected", "stereographic", "exact", "area", "lens"
]
Exposure = Annotated[
    Literal["paper", "metered"] | None,
    Parameter(help="Of a stack with both: paper or metered (default).", show_choices=False),
]
_CALIBRATION, _MICROSCOPE, _POSES, OUTPUT = (
    Parameter(group=Group.create_ordered(name))
    for name in ("Calibration", "Microscope", "Poses", "Output")
)
OUT = Parameter(alias="-o")
Rerun = Annotated[str | None, OUTPUT, Parameter(metavar="FILE|live")]


def _point(given: Any) -> tuple[float, float] | None:
    parts = _parts(given)
    if parts is None or parts == ["auto"]:
        return None
    try:
        return TypeAdapter(tuple[FiniteFloat, FiniteFloat]).validate_python(parts)
    except ValidationError:
        raise InputError("must be X,Y in px, such as 320,240, or auto") from None


def _turn(given: Any) -> Quaternion | None:
    if given is None:
        return None
    try:
        return unit_quaternion(TypeAdapter(Quaternion).validate_python(_parts(given)))
    except ValueError:
        raise InputError(
            "must be a unit quaternion QX,QY,QZ,QW, such as 0,0,0,1 for no turn"
        ) from None


def _parts(given: Any) -> Any:
    """The parts of 320,240 (from a command line, in a list) or [320, 240] (from a launch file)."""
    (text,) = given if isinstance(given, list) and len(given) == 1 else (given,)
    return text.split(",") if isinstance(text, str) else given


def _text(form: str) -> Parameter:
    return Parameter(metavar=form, n_tokens=1, allow_leading_hyphen=True)


class Given(BaseModel):
    """Options by their names: of a command, of a function, or of the rig's node."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    @classmethod
    def of(cls, given: Mapping[str, Any]) -> Self:
        """The given options, and the defaults of the others.

        Raises:
            InputError: an unknown option, or a value of the wrong kind.
        """
        # A preset or a file is a text, and a file may be given as its path.
        given = {name: str(v) if isinstance(v, Path) else v for name, v in given.items()}
        try:
            return cls.model_validate(given)
        except ValidationError as error:
            problem = error.errors()[0]
            name = problem["loc"][0]
            if name not in cls.model_fields:
                known = ", ".join(cls.model_fields)
                raise InputError(
                    f"{shortened(name)[1:-1]} is unknown; known are {known}."
                ) from error
            said = problem["msg"].replace("Input should be", "must be")
            rule = problem.get("ctx", {}).get("error", said)
            raise InputError(f"{name}: {rule}; got {shortened(given[str(name)])}.") from error


@Parameter(name="*")
class Options(Given):
    """How frames are measured, and how spots become distances.

    The one definition of these options: its fields are options of the commands and parameters of
    the rig's node.
    """

    mode: Annotated[
        Literal["auto", "subpixel", "literal", "pixels"],
        Parameter(show_choices=False, show_default=False),
    ] = "auto"
    """The default, auto, takes pixels for a lens if the camera's noise is known and its rate
    permits, else subpixel; literal is the paper's."""
    settings: Annotated[dict[str, float | str], Parameter(parse=False)] = {}
    """Values that differ from the defaults of `SubpixelSettings` or `LiteralSettings`."""
    rate_hz: Annotated[float | None, Field(gt=0), Parameter(parse=False)] = None
    """Frames a second of a camera, for the mode auto (default: the source's)."""
    start: Annotated[tuple[float, float] | None, BeforeValidator(_point), _text("X,Y|auto")] = None
    """Where the spot is first, px (default: auto)."""
    calibration: Path | None = None
    """File of eyespot fit; gives distances."""
    microscope: Annotated[Path | None, _MICROSCOPE] = None
    """Microscope or camera file (default: the stack's)."""
    pinhole_height_mm: Annotated[float | None, _MICROSCOPE] = None
    """Height above the eye's centre, if no file has it."""
    eye_radius_mm: Annotated[float | None, _MICROSCOPE] = None
    """Radius of the eyeball, if no file has it."""
    wall: Annotated[Literal["plane"] | None, _MICROSCOPE, Parameter(show_choices=False)] = None
    """Can be plane, square to the axis (default: file)."""
    full_scale: Annotated[float | None, Field(gt=0), _MICROSCOPE] = None
    """Largest value, e.g. 4095 (default: the file's)."""
    model: Annotated[DistanceModel | None, _CALIBRATION] = None
    """Distance model (default: the calibration's)."""
    eccentricity_mm: Annotated[float | None, _CALIBRATION] = None
    """Eccentricity of the spot (default: from its place)."""
    exposure_s: Annotated[float | None, Field(gt=0), _CALIBRATION] = None
    """Exposure time, model lens (default: the frame's)."""
    reference: Annotated[Path | None, _CALIBRATION] = None
    """Image with the beam off, for the mode pixels."""
    stated: Annotated[Path | None, _CALIBRATION] = None
    """Uncertainties you state (TOML); see docs/worth.md."""
    eye_from_robot: Annotated[
        Quaternion | None, BeforeValidator(_turn), _text("QX,QY,QZ,QW"), _POSES
    ] = None
    """Rotation from the poses' frame to the eye's."""

    def of_source(self, source: Source) -> Self:
        """These options with the source's rate, and its microscope file if none is given."""
        own = {"microscope": self.microscope or source.microscope_file}
        rate = {"rate_hz": source.rate_hz} if source.live and self.rate_hz is None else {}
        return self.model_copy(update=own | rate)

    def reader(self) -> Reader:
        """Read the files and prepare the measurement; `Ranger` says how long that takes.

        Raises:
            InputError: options or files are wrong, alone or together.
            OSError: a file cannot be read.
        """
        from eyespot.estimator.detector.literal import LiteralSettings
        from eyespot.estimator.distance.ranger import Ranger
        from eyespot.estimator.run.reader import LiteralMode, PixelsMode, SubpixelMode, best_mode
        from eyespot.formats.calibration import read_calibration

        for name, other in _NEEDS.items():
            if getattr(self, name) is not None and getattr(self, other) is None:
                raise InputError(
                    f"{option(name)} needs {option(other)} for this source. Give both, or neither."
                )
        microscope = self.microscope_file()
        beam = None if self.calibration is None else read_calibration(self.calibration)
        mode: str = self.mode
        of_outlines = ("model", "eccentricity_mm")
        asked = next((option(n) for n in of_outlines if getattr(self, n) is not None), "")
        if mode == "auto":
            mode, why = best_mode(beam, microscope, asked=asked, rate_hz=self.rate_hz)
            if why:
                say(why)
        settings = self._settings(mode, microscope)
        if self.reference is not None and mode != "pixels":
            raise InputError(
                f"--reference has no effect in the mode {mode}. Leave it out, or take the mode "
                "pixels."
            )
        ranger = None
        more: dict[str, Any] = {
            "eye_from_robot": self.eye_from_robot,
            "start": self.start,
            "size_px": (microscope.width_px, microscope.height_px) if microscope else None,
            "exposure_s": self.exposure_s,
        }
        if not isinstance(settings, LiteralSettings) and mode == "pixels":
            from eyespot.estimator.pixels.tracker import PixelRanger

            stated = self._stated(None)
            unused = stated.model_fields_set - {"axis_sigma_deg", "clock_sigma_s", "shake_px"}
            if unused:
                say(
                    f"The mode pixels does not use {', '.join(sorted(unused))} of {self.stated}; "
                    "the sub-pixel mode does."
                )
            if beam is None or microscope is None:
                raise InputError("the mode pixels needs a calibration. Give --calibration.")
            if asked:
                raise InputError(
                    f"{asked} has no effect in the mode pixels, whose geometry is exact. Leave it "
                    "out, or take the sub-pixel mode."
                )
            known_wall = self._reference_image(microscope)
            pixels = PixelRanger(beam, microscope, known_wall, shake_px=stated.shake_px)
            return PixelsMode(settings, pixels, stated=stated, **more)
        if beam is not None and microscope is not None:
            ranger = Ranger(
                beam, microscope, model=self.model, eccentricity_mm=self.eccentricity_mm
            )
        if ranger is not None and ranger.model == "area" and self.eye_from_robot is None:
            raise InputError(
                "the model area needs the robot's axis, so it needs eye_from_robot: the rotation "
                "from the poses' frame to the eye's (0,0,0,1 for none). Give it with the poses, or "
                "take the model exact."
            )
        stated = self._stated(beam)
        if isinstance(settings, LiteralSettings):
            return LiteralMode(settings, ranger, stated=stated, **more)
        return SubpixelMode(settings, ranger, stated=stated, **more)

    def _stated(self, calibration: Calibration | None) -> Stated:
        from eyespot.formats.stated import Stated, read_stated

        if self.stated is None:
            return Stated()
        stated = read_stated(self.stated)
        # Fits of a cone (exact) and of a lens have each trial's touch among their parameters.
        if stated.touch_sigma_mm and calibration and calibration.model in ("exact", "lens"):
            say(
                f"touch_sigma_mm of {self.stated} has no effect: the standard errors of "
                f"{self.calibration} contain the touch's, which eyespot fit --prior "
                "touch=MEAN,SIGMA sets."
            )
            stated = stated.model_copy(update={"touch_sigma_mm": 0.0})
        return stated

    def _reference_image(self, microscope: MicroscopeFile) -> np.ndarray | None:
        from eyespot.estimator.sources.opening import open_source

        if self.reference is None:
            return None
        image = next(frame for frame in open_source(self.reference) if not frame.fault).image
        height, width = image.shape[:2]
        if (width, height) != (microscope.width_px, microscope.height_px):
            raise InputError(
                f"{self.reference} is {width}x{height} px, but the microscope file is made for "
                f"{microscope.width_px}x{microscope.height_px} px. Take the reference with the same"
                " camera settings."
            )
        return image

    def microscope_file(self) -> MicroscopeFile | None:
        """Read the microscope file; None if none is given.

        Raises:
            InputError: it is wrong, or lacks a number that no option gives.
            OSError: it cannot be read.
        """
        from eyespot.formats.microscope import read_microscope

        if self.microscope is None:
            return None
        return read_microscope(
            self.microscope,
            pinhole_height_mm=self.pinhole_height_mm,
            eye_radius_mm=self.eye_radius_mm,
            plane_normal=(0.0, 0.0, 1.0) if self.wall else None,
        )

    def _settings(
        self, mode: str, microscope: MicroscopeFile | None
    ) -> LiteralSettings | SubpixelSettings:
        from eyespot.estimator.detector.literal import LiteralSettings
        from eyespot.estimator.detector.settings import SubpixelSettings
        from eyespot.formats.camera import Response

        given: dict[str, Any] = dict(self.settings)
        if given.keys() & {"response", "camera"}:
            raise InputError("settings are numbers; response and camera are the microscope file's.")
        camera = microscope.camera() if microscope else None
        response = microscope.response if microscope else Response()
        if self.full_scale is not None:
            response = replace(response, full_scale=self.full_scale)
        given["response"] = response
        if mode == "literal" and camera is not None:
            raise InputError(
                "the literal mode does not take the lens's distortion out, which the microscope"
                " file describes. Use the sub-pixel mode, or a microscope file without distortion."
            )
        try:
            if mode == "literal":
                return LiteralSettings(**given)
            return SubpixelSettings(camera=camera, **given)
        except TypeError as error:
            raise InputError(f"settings: {error}.") from error


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class RecordingOptions:
    """How a command reads a recording and its poses."""

    exposure: Exposure = None
    poses: Annotated[Path | None, _POSES] = None
    """Robot's poses (CSV or bag), on SOURCE's clock."""
    image_topic: Annotated[str | None, _POSES] = None
    """Image topic of a bag (default: the rig's)."""
    pose_topic: Annotated[str | None, _POSES] = None
    """Pose topic, bag or ROS (default: the rig's)."""

    def source(self, name: str) -> Source:
        """Open a recording, as `open_source`."""
        from eyespot.estimator.sources.opening import open_source

        return open_source(name, exposure=self.exposure, image_topic=self.image_topic)

    def opened(
        self, name: str, options: Options, *, unrelated: bool | None = None
    ) -> tuple[Source, Options, PoseTrack | None]:
        """Open a recording: its frames, the options with its microscope file, and the poses.

        Args:
            unrelated: measure every image by itself, or not; None leaves it to the source.
        """
        from eyespot.formats.calibration import read_calibration
        from eyespot.formats.microscope import read_microscope
        from eyespot.formats.stated import read_stated

        poses, frames = self.pose_track(options), self.source(name)
        if poses is None and options.stated and read_stated(options.stated).clock_sigma_s:
            say(f"clock_sigma_s of {options.stated} has no effect without --poses.")
        if unrelated is not None:
            frames = replace(frames, unrelated=unrelated)
        if options.calibration is not None and frames.medium:
            known = read_calibration(options.calibration).medium
            if known != frames.medium:
                raise InputError(
                    f"{frames.name} was taken in {frames.medium}, but {options.calibration} is "
                    f"valid in {known}. Calibrate the beam in {frames.medium}."
                )
        if frames.microscope_file is not None and (given := options.microscope_file()) is not None:
            own, other = (
                m.principal_point_px for m in (read_microscope(frames.microscope_file), given)
            )
            if np.hypot(*np.subtract(own, other)) > 1:
                places = [f"({x:.0f}, {y:.0f}) px by" for x, y in (other, own)]
                say(
                    f"The microscope's axis meets the image at {places[0]} {options.microscope}, "
                    f"but at {places[1]} {frames.microscope_file}. Distances depend on it."
                )
        return frames, options.of_source(frames), poses

    def pose_track(self, options: Options) -> PoseTrack | None:
        """Read the poses; None if none are given.

        Raises:
            InputError: an option has no effect without poses, or they are wrong.
            OSError: they cannot be read.
        """
        from eyespot.formats.poses import RobotKeys, read_poses

        if self.poses is not None:
            return read_poses(self.poses, robot=RobotKeys(pose_topic=self.pose_topic))
        needs = {"pose_topic": self.pose_topic, "eye_from_robot": options.eye_from_robot}
        for name, value in needs.items():
            if value is not None:
                raise InputError(f"{option(name)} needs --poses. Give both, or neither.")
        return None
