"""Microscope files: the stack's microscope.json, or a camera calibration of OpenCV, ROS or Kalibr.

All are read into one `MicroscopeFile`. A calibration describes the camera but not the eye: the
pinhole's height and the eye's radius come with the call.
"""

import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

import numpy as np
from pydantic import AfterValidator, ConfigDict, Field, PlainValidator, model_validator

from eyespot.formats.camera import CameraSheet, LensDistortion, Response
from eyespot.formats.camera_files import calibration_in, camera_of
from eyespot.formats.inputs import (
    InputError,
    Strict,
    check_schema,
    in_file,
    object_in,
    read_text,
    validated,
)

if TYPE_CHECKING:
    from eyespot import optics


_Series = Annotated[
    list[Annotated[float, Field(ge=-1e12, le=1e12)]], Field(min_length=1, max_length=1000)
]
Length = Annotated[float, Field(gt=0, le=1e6)]
"""A positive number of mm."""


def _sign(value: float) -> float:
    if abs(value) != 1.0:
        raise InputError("must be 1 (upright image) or -1 (inverted)")
    return value


class PathSeries(Strict):
    """Lines of sight through a viewing path, as `optics.viewing.camera.PathCamera` describes them.

    Attributes:
        crossing: Chebyshev coefficients of a.
        steepness_per_mm: Chebyshev coefficients of b, 1/mm.
        transmittance: Chebyshev coefficients of the transmittance.
        widest_mm: largest t of the series.
        pupil_mm: largest t that passes the iris; None if the iris stops no line of sight.
        orientation: +1 if the image is upright, -1 if it is inverted.
    """

    crossing: _Series
    steepness_per_mm: _Series
    transmittance: _Series
    widest_mm: Length
    pupil_mm: Length | None = None
    orientation: Annotated[float, AfterValidator(_sign)]

    @model_validator(mode="after")
    def _is_a_path(self) -> Self:
        lengths = [len(s) for s in (self.crossing, self.steepness_per_mm, self.transmittance)]
        if len(set(lengths)) > 1:
            raise InputError(
                "must have equally many coefficients of crossing, steepness_per_mm and "
                f"transmittance, not {lengths[0]}, {lengths[1]} and {lengths[2]}"
            )
        if not _on_axis(self.crossing):
            raise InputError("must have a crossing that is not 0 on the axis")
        return self

    @property
    def inverse_working_distance(self) -> float:
        """kappa of the path's paraxial pinhole, 1/mm."""
        return _on_axis(self.steepness_per_mm) / _on_axis(self.crossing)


def _on_axis(series: list[float]) -> float:
    """A Chebyshev series at t = 0, where its argument is -1 and T_n = (-1)^n."""
    return sum(series[::2]) - sum(series[1::2])


SCHEMA = 1
HISTORY = {1: "the format of eyespot 0.1"}

_BYTE = 8  # bits of most files; with more, they leave open where the camera's values end
_MOST_PX = 2**20  # sides of a frame, and the place of its principal point
_LARGEST_MM = 1e6
_LARGEST = 1e12  # largest number that is no length
_MOST_BYTES = 2**20
_STEEPEST = 100  # exponent of a gamma curve
_SAME = 1e-6  # relative; numbers that a file contains twice agree to JSON's digits
_UNIT = 1e-3  # deviation of a normal's length from 1 that comes from rounding
_SQUARE = 1e-3  # relative; half of it in the spot's radius is 6 um at d - b = 11 mm


@dataclass(frozen=True, kw_only=True, eq=False)
class MicroscopeFile:
    """A pinhole on the axis of the eye, looking down at the retinal pole, and the wall there.

    Attributes:
        width_px: of the frames.
        height_px: of the frames.
        camera_matrix: K of OpenCV, 3x3, px; None for a telecentric microscope.
        distortion: coefficients in OpenCV's order.
        scale_mm_px: delta at the height of the pole.
        principal_point_px: (u0, v0); may lie outside the frame.
        pinhole_height_mm: z_F above the eyeball's centre; infinite if telecentric. Below the pole,
            magnification grows with depth.
        eye_radius_mm: r; the pole lies at -r.
        response: relation of the frames' values to light; linear if the file does not say.
        paper_exposure_s: exposure time of the stack's frames of fixed exposure; None if unknown.
        plane_normal: of a plane wall through the pole, a unit vector towards the microscope; None
            if the wall is the eyeball.
        viewing_path: what lies between the microscope and the retina; `pinhole_height_mm` is then
            that of its paraxial pinhole. None for a pinhole.
        retina_semi_axes_mm: x, y and z of an ellipsoidal retina through the pole, placed as
            `optics.Ellipsoid` describes it; None for a sphere of `eye_radius_mm`.
        retina_tilt_deg: angle of its z from the microscope's axis.
        retina_tilt_azimuth_deg: azimuth of the direction in which its z leans.
        retina_shift_mm: of its centre across the microscope's axis.
        noise: data sheet of the camera; None if it was not measured.
        distortion_model: as `LensDistortion.model`; brown in files of ours.
    """

    width_px: int
    height_px: int
    camera_matrix: np.ndarray | None
    distortion: np.ndarray
    scale_mm_px: float
    principal_point_px: tuple[float, float]
    pinhole_height_mm: float
    eye_radius_mm: float
    response: Response = field(default_factory=Response)
    paper_exposure_s: float | None = None
    plane_normal: tuple[float, float, float] | None = None
    viewing_path: PathSeries | None = None
    retina_semi_axes_mm: Sequence[float] | None = None
    retina_tilt_deg: float = 0.0
    retina_tilt_azimuth_deg: float = 0.0
    retina_shift_mm: Sequence[float] = (0.0, 0.0)
    noise: CameraSheet | None = None
    distortion_model: Literal["brown", "equidistant"] = "brown"

    def __post_init__(self) -> None:
        """Reject what no microscope can have; four coefficients of distortion are five."""
        if self.distortion_model == "brown" and self.distortion.size == 4:
            object.__setattr__(self, "distortion", np.append(self.distortion, 0.0))
        if self.retina_semi_axes_mm is not None:
            across = min(self.retina_semi_axes_mm[:2])
            if not math.hypot(*self.retina_shift_mm) < across:
                raise InputError(
                    f"retina_shift_mm must be less than {across:g} mm, its smaller semi-axis "
                    f"across; got {list(self.retina_shift_mm)}. Restore the key."
                )
        for name in ("width_px", "height_px", "scale_mm_px", "eye_radius_mm"):
            value = getattr(self, name)
            most = _MOST_PX if name in ("width_px", "height_px") else _LARGEST_MM
            if not 0 < value <= most:
                raise InputError(f"{name} must be positive and at most {most:g}; got {value}.")
        reach = self.pinhole_height_mm + self.eye_radius_mm
        if not (reach > 0 or -math.inf < reach < 0):
            raise InputError(
                "pinhole_height_mm must lie above or below the retinal pole, which is at "
                f"-eye_radius_mm; got {self.pinhole_height_mm} mm with eye_radius_mm = "
                f"{self.eye_radius_mm}. It counts from the eyeball's centre, up."
            )
        normal = self.plane_normal or (0.0, 0.0, 1.0)
        if not (abs(math.hypot(*normal) - 1) < _UNIT and normal[2] > 0):
            raise InputError(
                f"plane_normal must be a unit vector towards the microscope (z > 0); got {normal}. "
                "A plane square to the microscope's axis has (0, 0, 1)."
            )
        if not (np.abs(self.principal_point_px) <= _MOST_PX).all():
            raise InputError(
                f"principal_point_px must lie within {_MOST_PX} px of the frame; got "
                f"{self.principal_point_px}."
            )

    @property
    def inverse_working_distance(self) -> float:
        """kappa = 1/(z_F + r), 1/mm; 0 if telecentric, negative for a pinhole below the pole."""
        return 1.0 / (self.pinhole_height_mm + self.eye_radius_mm)

    def wall(self) -> "optics.Surface":
        """The wall that the spots lie on. Loads JAX."""
        from eyespot import optics

        if self.plane_normal is not None:
            pole = np.array([0.0, 0.0, -self.eye_radius_mm])
            return optics.Plane(point=pole, inward=np.array(self.plane_normal))
        if self.retina_semi_axes_mm is None:
            return optics.Sphere(self.eye_radius_mm)
        x, y = self.retina_shift_mm
        return optics.Ellipsoid(
            np.array(self.retina_semi_axes_mm),
            shift=(x, y),
            tilt=math.radians(self.retina_tilt_deg),
            tilt_azimuth=math.radians(self.retina_tilt_azimuth_deg),
        )

    def camera(self) -> LensDistortion | None:
        """For `SubpixelSettings(camera=...)`; None if there is no distortion."""
        is_ideal = self.distortion_model == "brown" and not self.distortion.any()
        if self.camera_matrix is None or is_ideal:
            return None
        return LensDistortion(
            matrix=self.camera_matrix, distortion=self.distortion, model=self.distortion_model
        )

    def ideal_microscope(self) -> "optics.Camera":
        """The camera without distortion, in whose image undistorted spots lie. Loads JAX."""
        path = self.viewing_path
        if path is None:
            return self.pinhole()
        from eyespot.optics.viewing.camera import PathCamera

        # The time to compile a pose grows with the terms: without those that move no line of sight
        # by more than 1e-7 mm (2e-5 px).
        terms = 1
        for series in (path.crossing, path.steepness_per_mm):
            beyond = np.cumsum(np.abs(series[::-1]))[::-1] * path.widest_mm
            terms = max(terms, int(np.sum(beyond > 1e-7)))
        # Arrays: for plain numbers JAX would compile every time.
        array: Any = np.array
        return PathCamera(
            scale=array(self.scale_mm_px),
            principal_point=array(self.principal_point_px),
            pole_height=array(-self.eye_radius_mm),
            crossing=array(path.crossing[:terms]),
            steepness=array(path.steepness_per_mm[:terms]),
            passing=array(path.transmittance),
            widest=array(path.widest_mm),
            pupil=array(math.inf if path.pupil_mm is None else path.pupil_mm),
            orientation=array(path.orientation),
        )

    def pinhole(self) -> "optics.Microscope":
        """The pinhole without distortion, of a viewing path the paraxial one. Loads JAX."""
        from eyespot import optics

        return optics.microscope(
            scale=self.scale_mm_px,
            pinhole_height=self.pinhole_height_mm,
            eye_radius=self.eye_radius_mm,
            principal_point=self.principal_point_px,
        )


def read_microscope(
    path: str | Path,
    *,
    pinhole_height_mm: float | None = None,
    eye_radius_mm: float | None = None,
    plane_normal: tuple[float, float, float] | None = None,
) -> MicroscopeFile:
    """Read a microscope from a stack's microscope.json or from a camera calibration.

    Args:
        pinhole_height_mm: z_F above the eyeball's centre, for calibrations, which lack it.
        eye_radius_mm: r, for calibrations, which lack it.
        plane_normal: of a plane wall, for files that lack it, such as calibrations; None: the
            file's, or the eyeball.

    Raises:
        InputError: the file is neither, of another schema, contradicts itself, lacks
            something, or already holds what was given; the text says which key.
        OSError: the file cannot be read.
    """
    path = Path(path)
    given = {"pinhole_height_mm": pinhole_height_mm, "eye_radius_mm": eye_radius_mm}
    with in_file(path):
        text = read_text(path, most_bytes=_MOST_BYTES)
        content: dict[str, Any] = {}
        with suppress(InputError):  # or else it is YAML or XML
            content = object_in(text)
        if "schema" not in content:
            return _from_calibration(content or calibration_in(text), given, plane_normal)
        twice = [name for name, value in given.items() if value is not None]
        if plane_normal is not None:
            # A file of a version that did not know planes has no such key.
            twice += ["plane_normal"] * ("plane_normal" in content)
            content["plane_normal"] = list(plane_normal)
        if twice:
            raise InputError(
                f"{twice[0]} is in the file already. Leave it out of the call, or edit the file."
            )
        return microscope_in(content)


def _numbers(*shape: int) -> PlainValidator:
    """Finite numbers of a shape, or without one a list of any length, as an array."""

    def array(value: object) -> np.ndarray:
        try:
            found = np.asarray(value, float)
        except (TypeError, ValueError, OverflowError):
            found = np.asarray(math.nan)
        fits = found.shape == shape if shape else found.ndim == 1
        if not (fits and (np.abs(found) <= _LARGEST).all()):
            wanted = "x".join(map(str, shape)) or "a list"
            raise InputError(f"must be finite numbers ({wanted}), at most {_LARGEST:g}")
        return found

    return PlainValidator(
        array, json_schema_input_type=list[list[float]] if shape[1:] else list[float]
    )


def response_of(value: object) -> Response:
    """The scene file's names: linear, srgb, or g for the curve x^(1/g)."""
    if value == "linear" or value == "srgb":
        return Response(curve=value)
    if isinstance(value, int | float) and not isinstance(value, bool) and 0 < value <= _STEEPEST:
        return Response(curve="gamma", gamma=float(value))
    raise InputError("must be linear, srgb or the exponent of a gamma curve, at most 100")


_Pixels = Annotated[float, Field(ge=1, le=_MOST_PX)]
_Millimetres = Annotated[float, Field(ge=-_LARGEST_MM, le=_LARGEST_MM)]


class _PinholeFile(Strict):
    model_config = ConfigDict(extra="ignore", arbitrary_types_allowed=True)

    width_px: _Pixels
    height_px: _Pixels
    camera_matrix: Annotated[np.ndarray, _numbers(3, 3)]
    distortion: Annotated[np.ndarray, _numbers()]
    scale_mm_px: float
    principal_point_px: Annotated[np.ndarray, _numbers(2)]
    pinhole_height_mm: _Millimetres | None = None
    eye_radius_mm: _Millimetres
    response: Annotated[
        Response,
        PlainValidator(response_of, json_schema_input_type=Literal["linear", "srgb"] | float),
    ]
    full_scale: Annotated[float, Field(gt=0, le=_LARGEST)] | None = None
    paper_exposure_s: Annotated[float, Field(gt=0, le=_LARGEST)] | None = None
    plane_normal: Annotated[np.ndarray, _numbers(3)] | None = None
    viewing_path: None = None
    retina_semi_axes_mm: Annotated[list[Length], Field(min_length=3, max_length=3)] | None = None
    retina_tilt_deg: Annotated[float, Field(gt=-90, lt=90)] = 0.0
    retina_tilt_azimuth_deg: Annotated[float, Field(ge=-360, le=360)] = 0.0
    retina_shift_mm: Annotated[list[_Millimetres], Field(min_length=2, max_length=2)] | None = None
    camera: CameraSheet | None = None


class _TelecentricFile(_PinholeFile):
    camera_matrix: None = None  # type: ignore[assignment]


class _PathFile(_TelecentricFile):
    viewing_path: PathSeries  # type: ignore[assignment]


def microscope_in(content: dict[str, Any]) -> MicroscopeFile:
    """The microscope that the content of a microscope.json describes.

    Raises:
        InputError: another schema, or as `read_microscope`.
    """
    check_schema(content.get("schema"), HISTORY, remedy="Restore the file, or render again.")
    telecentric = content.get("pinhole_height_mm") is None
    through_path = content.get("viewing_path") is not None
    file = validated(
        _PathFile if through_path else _TelecentricFile if telecentric else _PinholeFile,
        content,
        remedy="Restore the key. With a viewing_path, or without pinhole_height_mm (a telecentric "
        "microscope), camera_matrix is null.",
    )
    values: dict[str, Any] = dict(file)
    camera, full_scale = values.pop("camera"), values.pop("full_scale")
    if full_scale is None and camera is not None and camera.bit_depth > _BYTE:
        full_scale = camera.full_scale
    values |= {
        "width_px": int(file.width_px),
        "height_px": int(file.height_px),
        "principal_point_px": tuple(file.principal_point_px.tolist()),
        "pinhole_height_mm": math.inf if telecentric else file.pinhole_height_mm,
        "response": replace(file.response, full_scale=full_scale),
        "plane_normal": None if file.plane_normal is None else tuple(file.plane_normal.tolist()),
        "retina_shift_mm": file.retina_shift_mm or (0.0, 0.0),
        "noise": camera,
    }
    microscope = MicroscopeFile(**values)
    _check_agreement(microscope)
    return microscope


def _check_agreement(microscope: MicroscopeFile) -> None:
    """Refuse a file in which only one of two copies of a number was edited."""
    matrix, path = microscope.camera_matrix, microscope.viewing_path
    retina = microscope.retina_semi_axes_mm
    if matrix is not None:
        focal = 1.0 / (microscope.inverse_working_distance * microscope.scale_mm_px)
        said = (matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2])
        implied = (focal, focal, *microscope.principal_point_px)
        if not np.allclose(said, implied, rtol=_SAME, atol=1e-6):
            listed = [", ".join(f"{value:.6g}" for value in four) for four in (said, implied)]
            raise InputError(
                f"camera_matrix has (fx, fy, cx, cy) = {listed[0]} px, but (pinhole_height_mm + "
                f"eye_radius_mm)/scale_mm_px and principal_point_px say {listed[1]} px. Change "
                "both alike."
            )
    if path is not None:
        if microscope.distortion.any():
            raise InputError(
                "distortion must be 0 with a viewing_path, which contains the lenses' distortion; "
                f"got {microscope.distortion.tolist()}. Undistort the images first."
            )
        own, of_path = microscope.inverse_working_distance, path.inverse_working_distance
        if not math.isclose(own, of_path, rel_tol=_SAME, abs_tol=_SAME):
            raise InputError(
                f"pinhole_height_mm and eye_radius_mm say 1/(z_F + r) = {own:.6g}/mm, but "
                f"viewing_path says {of_path:.6g}/mm on the axis. Change both alike."
            )
    if retina is not None and microscope.plane_normal is not None:
        raise InputError(
            f"plane_normal {microscope.plane_normal} and retina_semi_axes_mm "
            f"{list(retina)} describe two walls. Remove one."
        )
    if retina and not math.isclose(retina[2], microscope.eye_radius_mm, rel_tol=_SAME):
        raise InputError(
            f"eye_radius_mm must be the semi-axis along z of retina_semi_axes_mm, "
            f"{retina[2]:g} mm; got {microscope.eye_radius_mm:g} mm. Change both "
            "alike."
        )


def _from_calibration(
    content: dict[str, Any],
    given: dict[str, float | None],
    plane_normal: tuple[float, float, float] | None,
) -> MicroscopeFile:
    camera, size = camera_of(content)
    for name, value in given.items():
        if value is None or not math.isfinite(value):
            raise InputError(
                f"a camera calibration does not hold {name}. Give it with the file, in mm; got "
                f"{value}."
            )
    height, radius = (value or 0.0 for value in given.values())
    (fx, skew, u), (_, fy, v), _ = camera.matrix.tolist()
    if abs(fx - fy) > _SQUARE * fx or abs(skew) > _SQUARE * fx:
        raise InputError(
            f"camera_matrix must have square pixels without skew to {_SQUARE:g} of fx; got fx = "
            f"{fx:g} px, fy = {fy:g} px, skew = {skew:g} px. Calibrate with "
            "cv2.CALIB_FIX_ASPECT_RATIO."
        )
    return MicroscopeFile(
        width_px=size[0],
        height_px=size[1],
        camera_matrix=camera.matrix,
        distortion=camera.distortion,
        distortion_model=camera.model,
        # Below the pole, the pinhole that the eye shows sees a pixel under the same angle.
        scale_mm_px=abs(height + radius) / math.sqrt(fx * fy),
        principal_point_px=(u, v),
        pinhole_height_mm=height,
        eye_radius_mm=radius,
        plane_normal=plane_normal,
    )
