"""The options of a measurement, defined once for the commands and for the rig's node."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, NamedTuple, Self

import numpy as np
from cyclopts import Group, Parameter
from cyclopts.validators import Number
from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    FiniteFloat,
    TypeAdapter,
    ValidationError,
)

from eyespot.estimator.run.option_names import moved, option
from eyespot.estimator.run.progress_bar import say
from eyespot.formats.inputs import InputError, shortened
from eyespot.formats.settings_files import change_of

if TYPE_CHECKING:
    from eyespot.estimator.detector.literal import LiteralSettings
    from eyespot.estimator.detector.settings import SubpixelSettings
    from eyespot.estimator.recording import Recording
    from eyespot.estimator.run.reader import Reader
    from eyespot.formats.calibration import Calibration
    from eyespot.formats.camera_sheet import Response
    from eyespot.formats.microscope import MicroscopeFile
    from eyespot.formats.rig import Rig

DistanceModel = Literal[
    "planar", "small_plane", "corrected", "stereographic", "exact", "area", "lens"
]
Exposure = Annotated[
    Literal["paper", "metered"] | None,
    Parameter(help="Of a stack with both: paper or metered (default).", show_choices=False),
]
_CALIBRATION, _RIG, OUTPUT = (
    Parameter(group=Group.create_ordered(name)) for name in ("Calibration", "Rig", "Output")
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


def _changes(given: Any) -> Any:
    """Changes as KEY=VALUE, also of {KEY: VALUE}."""
    if isinstance(given, Mapping):
        return tuple(change_of(*item) for item in given.items())
    return tuple(given) if isinstance(given, list) else given


RigChanges = Annotated[
    tuple[str, ...],
    BeforeValidator(_changes),
    Parameter("--set", metavar="KEY=VALUE", show_default=False),
]
"""Changes of a rig file's keys, on a command line or as {KEY: VALUE}."""


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
        given = {name: _text_of(value) for name, value in given.items()}
        try:
            return cls.model_validate(given)
        except ValidationError as error:
            problem = error.errors()[0]
            name = problem["loc"][0]
            if name not in cls.model_fields and (said := moved(str(name))):
                raise InputError(said) from error
            if name not in cls.model_fields:
                known = ", ".join(cls.model_fields)
                raise InputError(
                    f"{shortened(name)[1:-1]} is unknown; known are {known}."
                ) from error
            said = problem["msg"].replace("Input should be", "must be")
            rule = problem.get("ctx", {}).get("error", said)
            raise InputError(f"{name}: {rule}; got {shortened(given[str(name)])}.") from error


def _text_of(value: Any) -> Any:
    """A path as text, and those in a list."""
    if isinstance(value, list | tuple):
        return tuple(map(_text_of, value))
    return str(value) if isinstance(value, Path) else value


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
    rig: Annotated[Path | None, _RIG] = None
    """Rig file, microscope.json or camera file (default: the stack's own)."""
    changes: Annotated[RigChanges, _RIG] = ()
    """Change a key of the rig file, such as wall.medium=air. Repeatable."""
    model: Annotated[DistanceModel | None, _CALIBRATION] = None
    """Distance model (default: the calibration's)."""
    eccentricity_mm: Annotated[float | None, _CALIBRATION] = None
    """Eccentricity of the spot (default: from its place)."""
    exposure_s: Annotated[float | None, Field(gt=0), _CALIBRATION] = None
    """Exposure time, model lens (default: the frame's)."""
    reference: Annotated[Path | None, _CALIBRATION] = None
    """Image with the beam off, for the mode pixels."""

    def of_recording(self, recording: Recording) -> Self:
        """These options with the rate of a recording's camera, and the calibration of its rig."""
        source = recording.source
        rate = {"rate_hz": source.rate_hz} if source.live and self.rate_hz is None else {}
        own = {"calibration": self.calibration or recording.rig.calibration_file}
        return self.model_copy(update=own | rate)

    def own_rig(self) -> Rig:
        """Read the rig file; a rig of which nothing is known if none is given."""
        from eyespot.formats.rig import Rig, read_rig

        return (Rig() if self.rig is None else read_rig(self.rig)).changed(self.changes)

    def beam(self) -> Calibration | None:
        """Read the calibration; None if none is given."""
        from eyespot.formats.calibration import read_calibration

        return None if self.calibration is None else read_calibration(self.calibration)

    def reader(self, rig: Rig | None = None, beam: Calibration | None = None) -> Reader:
        """Prepare the measurement; `Ranger` says how long that takes.

        Args:
            rig: of the frames; None: that of these options.
            beam: the calibration, which was read before; None: it is read now, if one is given.

        Raises:
            InputError: options, rig and calibration do not fit together.
            OSError: a file cannot be read.
        """
        from eyespot.estimator.detector.literal import LiteralSettings
        from eyespot.estimator.distance.ranger import Ranger
        from eyespot.estimator.run.reader import LiteralMode, PixelsMode, SubpixelMode, best_mode

        rig = rig or self.own_rig()
        microscope, turn, stated = rig.view, rig.robot.eye_from_robot, rig.stated
        if microscope is None and (beam is not None or self.calibration is not None):
            raise InputError(
                "--calibration needs the microscope: its scale and its pinhole. Give --rig FILE, "
                "which `eyespot rig init` writes."
            )
        beam = beam or self.beam()
        if beam is None:
            for name in ("model", "eccentricity_mm", "exposure_s"):
                if getattr(self, name) is not None:
                    raise InputError(f"{option(name)} needs --calibration. Give both, or neither.")
        else:
            _check_medium(rig, beam)
            own_path = microscope is not None and microscope.viewing_path is not None
            beam = beam.seen_by(rig.microscope.id, own_path=own_path)
            if beam.model in ("exact", "lens"):  # its errors contain the touch's
                stated = stated.model_copy(update={"touch_sigma_mm": 0.0})
        mode: str = self.mode
        of_outlines = ("model", "eccentricity_mm")
        asked = next((option(n) for n in of_outlines if getattr(self, n) is not None), "")
        if mode == "auto":
            mode, why = best_mode(beam, microscope, asked=asked, rate_hz=self.rate_hz)
            if why:
                say(why)
        settings = self._settings(mode, microscope, rig.response)
        if self.reference is not None and mode != "pixels":
            raise InputError(
                f"--reference has no effect in the mode {mode}. Leave it out, or take the mode "
                "pixels."
            )
        more: dict[str, Any] = {
            "eye_from_robot": turn,
            "start": self.start,
            "size_px": (microscope.width_px, microscope.height_px) if microscope else None,
            "exposure_s": self.exposure_s,
            "stated": stated,
        }
        if not isinstance(settings, LiteralSettings) and mode == "pixels":
            from eyespot.estimator.pixels.tracker import PixelRanger

            if beam is None or microscope is None:
                raise InputError("the mode pixels needs a calibration. Give --calibration.")
            if asked:
                raise InputError(
                    f"{asked} has no effect in the mode pixels, whose geometry is exact. Leave it "
                    "out, or take the sub-pixel mode."
                )
            known_wall = self._reference_image(microscope)
            pixels = PixelRanger(beam, microscope, known_wall, shake_px=rig.unrest.shake_px)
            return PixelsMode(settings, pixels, **more)
        ranger = None
        if beam is not None and microscope is not None:
            ranger = Ranger(
                beam,
                microscope,
                model=self.model,
                eccentricity_mm=self.eccentricity_mm,
                scale_sigma=stated.scale_sigma,
            )
        if ranger is not None and ranger.model == "area" and turn is None:
            raise InputError(
                "the model area needs the robot's axis, so it needs robot.eye_from_robot of the "
                "rig file: the rotation from the poses' frame to the eye's (0, 0, 0, 1 for none). "
                "Give it with the poses, or take the model exact."
            )
        if isinstance(settings, LiteralSettings):
            return LiteralMode(settings, ranger, **more)
        return SubpixelMode(settings, ranger, **more)

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

    def _settings(
        self, mode: str, microscope: MicroscopeFile | None, response: Response
    ) -> LiteralSettings | SubpixelSettings:
        from eyespot.estimator.detector.literal import LiteralSettings
        from eyespot.estimator.detector.settings import SubpixelSettings

        given: dict[str, Any] = dict(self.settings)
        if given.keys() & {"response", "camera"}:
            raise InputError("settings are numbers; response and camera are the microscope file's.")
        camera = microscope.camera() if microscope else None
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
    fps: Annotated[float | None, Parameter(validator=Number(gt=0))] = None
    """Images a second, of a folder without frames.csv (file,time_s,exposure_s) or of a TIFF."""
    poses: Annotated[Path | None, _RIG] = None
    """Robot's poses (CSV or bag), on SOURCE's clock; [robot] of the rig says what they mean."""

    def opened(self, source: Any, options: Options, *, unrelated: bool | None = None) -> Opened:
        """Open a recording with its rig and poses, and read the calibration.

        Args:
            source: as `Recording.open` takes it.
            unrelated: measure every image by itself, or not; None leaves it to the source.
        """
        from eyespot.estimator.recording import Recording

        recording = Recording.open(
            source,
            rig=options.rig,
            changes=options.changes,
            poses=self.poses,
            exposure=self.exposure,
            fps=self.fps,
        ).unrelated(unrelated)
        return prepared(recording, options)


def prepared(recording: Recording, options: Options, beam: Calibration | None = None) -> Opened:
    """Read the calibration, and see to what the mode needs of an opened recording.

    Args:
        beam: the calibration; None: the options' or the rig's.
    """
    options = options.of_recording(recording)
    beam, view = beam or options.beam(), recording.rig.view
    of_pixels = options.mode == "pixels" or (options.mode == "auto" and _is_lens(beam))
    if of_pixels and view is not None and view.noise is None and not recording.source.live:
        recording = recording.measured()
    robot = recording.rig.robot
    if beam is not None and recording.poses() is not None and robot.eye_from_robot is None:
        say(
            "robot.eye_from_robot of the rig file is not stated, so the beam's axis is not known. "
            "`eyespot rig check` proposes it."
        )
    _check_axis(recording)
    return Opened(recording, options, beam)


def _is_lens(beam: Calibration | None) -> bool:
    return beam is not None and beam.model == "lens"


class Opened(NamedTuple):
    """A recording, the options with which it is measured, and the beam's calibration."""

    recording: Recording
    options: Options
    beam: Calibration | None

    def reader(self) -> Reader:
        """As `Options.reader`."""
        return self.options.reader(self.recording.rig, self.beam)


def _check_axis(recording: Recording) -> None:
    """Say where a rig file places the microscope's axis elsewhere than the stack itself."""
    own, given = recording.source.rig, recording.rig
    if own is None or given is own or own.view is None or given.view is None:
        return
    places = [view.principal_point_px for view in (given.view, own.view)]
    if math.dist(*places) > 1:
        named = [f"({x:.0f}, {y:.0f}) px" for x, y in places]
        say(
            f"The microscope's axis meets the image at {named[0]} by the rig file, but at "
            f"{named[1]} by {recording.source.name}. Distances depend on it."
        )


def _check_medium(rig: Rig, beam: Calibration) -> None:
    medium = rig.wall.medium
    if medium is not None and beam.medium.name != medium:
        raise InputError(
            f"the frames were taken in {medium}, but the calibration is valid in "
            f"{beam.medium.name}. "
            f"Calibrate the beam in {medium}, or correct wall.medium of the rig file."
        )
