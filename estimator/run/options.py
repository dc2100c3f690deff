"""What a person chooses for a measurement, for `eyespot track` and for the rig's node alike."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    FiniteFloat,
    PositiveFloat,
    TypeAdapter,
    ValidationError,
)

from estimator.detector import LiteralSettings, SubpixelSettings
from estimator.distance import Ranger
from estimator.files import (
    MicroscopeFile,
    Quaternion,
    read_calibration,
    read_microscope,
    unit_quaternion,
)
from estimator.run.reader import Reader

_NEEDS = {
    **dict.fromkeys(("pinhole_height_mm", "eye_radius_mm", "calibration"), "microscope"),
    **dict.fromkeys(("model", "eccentricity_mm", "exposure_s", "eye_from_robot"), "calibration"),
}

_POINT = TypeAdapter(tuple[FiniteFloat, FiniteFloat])
_QUATERNION = TypeAdapter(Quaternion)


def _point(given: Any) -> tuple[float, float] | None:
    if given is None or given == "auto":
        return None
    try:
        return _POINT.validate_python(_parts(given))
    except ValidationError:
        raise ValueError("must be X,Y in px, such as 320,240, or auto") from None


def _turn(given: Any) -> Quaternion | None:
    if given is None:
        return None
    try:
        return unit_quaternion(_QUATERNION.validate_python(_parts(given)))
    except ValueError:
        raise ValueError(
            "must be a unit quaternion QX,QY,QZ,QW, such as 0,0,0,1 for no turn"
        ) from None


def _parts(given: Any) -> Any:
    """A command line has 320,240 and a launch file [320, 240]."""
    return given.split(",") if isinstance(given, str) else given


class Options(BaseModel):
    """How frames are measured, and how spots become distances.

    Attributes:
        mode: of the measurement.
        settings: that differ from the defaults of `SubpixelSettings` or `LiteralSettings`.
        start: (x, y) of the spot in the first image, px; None, written "auto", finds it.
        microscope: file, see `read_microscope`.
        pinhole_height_mm: z_F, where the microscope file is OpenCV's.
        eye_radius_mm: r, where the microscope file is OpenCV's.
        calibration: file, see `read_calibration`; without it there are no distances.
        model: of the distance; by default the calibration's.
        eccentricity_mm: c of the spots; by default it is read off each spot's position.
        exposure_s: of the images, for the model `lens`; by default what each image tells.
        eye_from_robot: unit quaternion x, y, z, w that turns vectors of the robot's frame into the
            eye's. With it `exact` takes the beam's axis from the tool's +z.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    mode: Literal["subpixel", "literal"] = "subpixel"
    settings: dict[str, float | str] = {}
    start: Annotated[tuple[float, float] | None, BeforeValidator(_point)] = None
    microscope: Path | None = None
    pinhole_height_mm: float | None = None
    eye_radius_mm: float | None = None
    calibration: Path | None = None
    model: str | None = None
    eccentricity_mm: float | None = None
    exposure_s: PositiveFloat | None = None
    eye_from_robot: Annotated[Quaternion | None, BeforeValidator(_turn)] = None

    @classmethod
    def of(cls, given: Mapping[str, Any]) -> Self:
        """The options that were given, and the defaults of the others.

        Raises:
            ValueError: a name that is no option, or a value of the wrong kind.
        """
        try:
            return cls.model_validate(given)
        except ValidationError as error:
            problem = error.errors()[0]
            name = problem["loc"][0]
            if name not in cls.model_fields:
                known = ", ".join(cls.model_fields)
                raise ValueError(f"{name} is unknown; known are {known}.") from error
            told = problem.get("ctx", {}).get("error", problem["msg"])
            raise ValueError(f"{name}: {told}; got {given[str(name)]!r}.") from error

    def reader(self) -> Reader:
        """Read the files and make what measures frames; see `Ranger` for how long that takes.

        Raises:
            ValueError: options or files that make no sense, alone or together.
            OSError: a file cannot be read.
        """
        for name, other in _NEEDS.items():
            if getattr(self, name) is not None and getattr(self, other) is None:
                raise ValueError(f"{name} does nothing without {other}. Give both, or neither.")
        microscope = ranger = None
        if self.microscope is not None:
            microscope = read_microscope(
                self.microscope,
                pinhole_height_mm=self.pinhole_height_mm,
                eye_radius_mm=self.eye_radius_mm,
            )
        settings = self._settings(microscope)
        if self.calibration is not None and microscope is not None:
            ranger = Ranger(
                read_calibration(self.calibration),
                microscope,
                model=self.model,
                eccentricity_mm=self.eccentricity_mm,
            )
        return Reader(
            settings,
            start=self.start,
            size_px=(microscope.width_px, microscope.height_px) if microscope else None,
            ranger=ranger,
            exposure_s=self.exposure_s,
            eye_from_robot=self.eye_from_robot,
        )

    def _settings(self, microscope: MicroscopeFile | None) -> LiteralSettings | SubpixelSettings:
        given: dict[str, Any] = dict(self.settings)
        if given.keys() & {"response", "camera", "reference"}:
            raise ValueError("settings are numbers; response and camera are the microscope file's.")
        camera = None
        if microscope is not None:
            camera, given["response"] = microscope.camera(), microscope.response
        if self.mode == "literal" and camera is not None:
            raise ValueError(
                "the literal mode does not take the lens's distortion out, which the microscope"
                " file describes. Use the sub-pixel mode, or a microscope file without distortion."
            )
        try:
            if self.mode == "literal":
                return LiteralSettings(**given)
            return SubpixelSettings(camera=camera, **given)
        except TypeError as error:
            raise ValueError(f"settings: {error}.") from error
