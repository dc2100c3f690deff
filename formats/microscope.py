"""Microscope files: the stack's microscope.json, or a camera calibration of OpenCV, ROS or Kalibr.

All are read into one `MicroscopeFile`. A calibration describes the camera but not the eye: the
pinhole's height and the eye's radius come with the call.
"""

import math
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

import numpy as np
from pydantic import (
    AfterValidator,
    AllowInfNan,
    BeforeValidator,
    ConfigDict,
    Field,
    PlainValidator,
    ValidationInfo,
    field_validator,
    model_validator,
)
from pydantic import Strict as StrictType

from eyespot.formats.camera_files import calibration_in, camera_of
from eyespot.formats.camera_sheet import CameraSheet, LensDistortion, Response
from eyespot.formats.inputs import (
    InputError,
    Strict,
    check_schema,
    in_file,
    object_in,
    read_text,
    shortened,
    validated,
)
from eyespot.formats.settings_files import PairKey, VectorKey

if TYPE_CHECKING:
    from jaxtyping import Float

    from eyespot import optics

SCHEMA = 1
HISTORY = {1: "the format of eyespot 0.1"}

_BITS_OF_MOST_FILES = 8
"""Bits of most files; with more, they leave open where the camera's values end."""
_MAX_FRAME_PX = 2**20  # sides of a frame, and the place of its principal point
_MOST_BYTES = 2**20
_AGREEMENT_TOLERANCE = 1e-6  # relative; numbers that a file contains twice agree to JSON's digits
_UNIT_LENGTH_TOLERANCE = 1e-3  # deviation of a normal's length from 1 that comes from rounding
_SKEW_TOLERANCE = 1e-3  # relative; half of it in the spot's radius is 6 um at d - b = 11 mm

_Number = Annotated[float, Field(ge=-1e12, le=1e12)]
_Positive = Annotated[float, Field(gt=0, le=1e12)]
_Series = Annotated[tuple[_Number, ...], StrictType(False), Field(min_length=1, max_length=1000)]
_Vector = Annotated[tuple[_Number, _Number, _Number], StrictType(False)]
_Matrix = Annotated[tuple[_Vector, _Vector, _Vector], StrictType(False)]
_Place = Annotated[float, Field(ge=-_MAX_FRAME_PX, le=_MAX_FRAME_PX)]
_Pixels = Annotated[
    int,
    BeforeValidator(lambda n: int(n) if isinstance(n, float) and n.is_integer() else n),
    Field(ge=1, le=_MAX_FRAME_PX),
]
Length = Annotated[float, Field(gt=0, le=1e6)]
"""A positive number of mm."""


def _sign(value: float) -> float:
    if abs(value) != 1.0:
        raise InputError("must be 1 (upright image) or -1 (inverted)")
    return value


def _curve(value: object) -> object:
    known = isinstance(value, int | float) and not isinstance(value, bool) and 0 < value <= 100
    if not known and value not in ("linear", "srgb"):
        raise InputError("must be linear, srgb or the exponent of a gamma curve, at most 100")
    return value


def response_of(curve: str | float, *, full_scale: float | None, limited_range: bool) -> Response:
    """The response of a curve as files name it: linear, srgb, or g for x^(1/g)."""
    if isinstance(curve, str):
        curves: Any = {"curve": curve}
    else:
        curves = {"curve": "gamma", "gamma": float(curve)}
    return Response(**curves, full_scale=full_scale, limited=limited_range)


class PathSeries(Strict):
    """Lines of sight through a viewing path, as `optics.viewing.projection.PathCamera` has them."""

    crossing: _Series = Field(description="Chebyshev coefficients of a.")
    steepness_per_mm: _Series = Field(description="Chebyshev coefficients of b, 1/mm.")
    transmittance: _Series = Field(description="Chebyshev coefficients of the transmittance.")
    widest_mm: Length = Field(description="Largest t of the series, mm.")
    pupil_mm: Length | None = Field(
        None,
        description="Largest t that passes the iris, mm; null if it stops no line of sight.",
    )
    orientation: Annotated[float, AfterValidator(_sign)] = Field(
        description="1 if the image is upright, -1 if it is inverted."
    )

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


def _on_axis(series: tuple[float, ...]) -> float:
    """A Chebyshev series at t = 0, where its argument is -1 and T_n = (-1)^n."""
    return sum(series[::2]) - sum(series[1::2])


class MicroscopeFile(Strict):
    """A pinhole on the axis of the eye, looking down at the retinal pole, and the wall there.

    The keys are those of microscope.json; in one of another program, unknown keys are ignored.
    """

    model_config = ConfigDict(extra="ignore", populate_by_name=True)

    width_px: _Pixels = Field(description="Width of the images.")
    height_px: _Pixels = Field(description="Height of the images.")
    camera_matrix: _Matrix | None = Field(
        description="K of OpenCV, 3x3, px; null if telecentric or behind a viewing path."
    )
    distortion_model: Literal["brown", "equidistant"] = Field(
        "brown", description="Of `LensDistortion`: that of cv2.calibrateCamera, or of cv2.fisheye."
    )
    distortion: Annotated[tuple[_Number, ...], StrictType(False)] = Field(
        description="Coefficients in OpenCV's order."
    )
    scale_mm_px: Length = Field(description="Size of a pixel at the height of the pole, delta.")
    principal_point_px: Annotated[tuple[_Place, _Place], StrictType(False)] = Field(
        description="(u0, v0), where the microscope's axis meets the image, in it or outside of it."
    )
    pinhole_height_mm: Annotated[
        float,
        AllowInfNan(),
        BeforeValidator(
            lambda height: math.inf if height is None else height,
            json_schema_input_type=float | None,
        ),
        Field(ge=-1e6),
    ] = Field(
        math.inf,
        description="z_F, height of the pinhole above the eyeball's centre; null if telecentric. "
        "Below the pole, magnification grows with depth.",
    )
    eye_radius_mm: Length = Field(description="r; the pole lies at -r.")
    curve: Annotated[
        str | float,
        PlainValidator(_curve, json_schema_input_type=Literal["linear", "srgb"] | float),
    ] = Field(
        alias="response",
        description="Values of light: linear, srgb, or the exponent g of the curve x^(1/g).",
    )
    full_scale: _Positive | None = Field(
        None, description="Value of the brightest light that the camera measures, such as 4095."
    )
    limited_range: bool = Field(
        False, description="Whether black is at 16 and white at 235 of 255, as in video."
    )
    paper_exposure_s: _Positive | None = Field(
        None, description="Exposure time of the stack's frames of fixed exposure, s."
    )
    plane_normal: VectorKey | None = Field(
        None,
        description="Of a plane wall through the pole, a unit vector towards the microscope; null "
        "if the wall is the eyeball.",
    )
    viewing_path: PathSeries | None = Field(
        None,
        description="What lies between the microscope and the retina; `pinhole_height_mm` is then "
        "that of its paraxial pinhole.",
    )
    retina_semi_axes_mm: Annotated[tuple[Length, Length, Length], StrictType(False)] | None = Field(
        None,
        description="x, y and z of an ellipsoidal retina through the pole, placed as "
        "`optics.Ellipsoid` describes it; without it a sphere.",
    )
    retina_tilt_deg: Annotated[float, Field(gt=-90, lt=90)] = Field(
        0.0, description="Angle of its z from the microscope's axis."
    )
    retina_tilt_azimuth_deg: Annotated[float, Field(ge=-360, le=360)] = Field(
        0.0, description="Azimuth of the direction in which its z leans."
    )
    retina_shift_mm: PairKey | None = Field(
        None, description="Of its centre across the microscope's axis: x, y."
    )
    noise: CameraSheet | None = Field(
        None,
        alias="camera",
        description="Noise of the camera by its data sheet (EMVA 1288); the mode pixels needs it.",
    )

    @field_validator("distortion")
    @classmethod
    def _has_five(cls, found: tuple[float, ...], others: ValidationInfo) -> tuple[float, ...]:
        is_short = len(found) == 4 and others.data.get("distortion_model") == "brown"
        return (*found, 0.0) if is_short else found

    @model_validator(mode="after")
    def _is_possible(self) -> Self:
        shift = self.retina_shift_mm or (0.0, 0.0)
        if self.retina_semi_axes_mm is not None:
            across = min(self.retina_semi_axes_mm[:2])
            if not math.hypot(*shift) < across:
                raise InputError(
                    f"retina_shift_mm must be less than {across:g} mm, its smaller semi-axis "
                    f"across; got {list(shift)}"
                )
        reach = self.pinhole_height_mm + self.eye_radius_mm
        if reach == 0:
            raise InputError(
                "pinhole_height_mm must lie above or below the retinal pole, which is at "
                f"-eye_radius_mm; got {self.pinhole_height_mm} mm with eye_radius_mm = "
                f"{self.eye_radius_mm}. It counts from the eyeball's centre, up"
            )
        normal = self.plane_normal or (0.0, 0.0, 1.0)
        if not (abs(math.hypot(*normal) - 1) < _UNIT_LENGTH_TOLERANCE and normal[2] > 0):
            raise InputError(
                f"plane_normal must be a unit vector towards the microscope (z > 0); got {normal}. "
                "A plane square to the microscope's axis has (0, 0, 1)"
            )
        return self

    def changed(self, **values: Any) -> Self:
        """The microscope with other values.

        Raises:
            InputError: no microscope has them.
        """
        return validated(type(self), dict(self) | values, remedy="Correct the value.")

    @property
    def response(self) -> Response:
        """Relation of the frames' values to light."""
        return response_of(self.curve, full_scale=self.full_scale, limited_range=self.limited_range)

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
        x, y = self.retina_shift_mm or (0.0, 0.0)
        return optics.Ellipsoid(
            np.array(self.retina_semi_axes_mm),
            shift=(x, y),
            tilt=math.radians(self.retina_tilt_deg),
            tilt_azimuth=math.radians(self.retina_tilt_azimuth_deg),
        )

    def camera(self) -> LensDistortion | None:
        """For `SubpixelSettings(camera=...)`; None if there is no distortion."""
        is_ideal = self.distortion_model == "brown" and not any(self.distortion)
        if self.camera_matrix is None or is_ideal:
            return None
        return LensDistortion(
            matrix=np.array(self.camera_matrix),
            distortion=np.array(self.distortion),
            model=self.distortion_model,
        )

    def require_wall_at(self, at_px: "Float[np.ndarray, 'n 2']") -> None:
        """Raise an InputError if a line of sight through an undistorted pixel misses the wall."""
        from eyespot.optics.surface import MISS

        found = self.wall().intersect(*self.ideal_microscope().ray(at_px))
        missed = np.asarray(found.status) == MISS
        if missed.any():
            away_px = np.linalg.norm(at_px - np.array(self.principal_point_px), axis=1)
            raise InputError(
                f"{missed.sum()} of {missed.size} spots lie beside the wall: up to "
                f"{away_px.max() * self.scale_mm_px:.3g} mm from the microscope's axis, in an eye "
                f"of {self.eye_radius_mm:g} mm radius. Correct microscope.scale_mm_px (now "
                f"{self.scale_mm_px:g}), microscope.principal_point_px or wall.radius_mm."
            )

    def ideal_microscope(self) -> "optics.Camera":
        """The camera without distortion, in whose image undistorted spots lie. Loads JAX."""
        path = self.viewing_path
        if path is None:
            return self.pinhole()
        from eyespot.optics.viewing.projection import PathCamera

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
) -> MicroscopeFile:
    """Read a microscope from a stack's microscope.json or from a camera calibration.

    Args:
        pinhole_height_mm: z_F above the eyeball's centre, for calibrations, which lack it.
        eye_radius_mm: r, for calibrations, which lack it.

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
            return _from_calibration(content or calibration_in(text), given)
        if twice := [name for name, value in given.items() if value is not None]:
            raise InputError(
                f"{twice[0]} is in the file already. Leave it out of the call, or edit the file."
            )
        return microscope_in(content)


def microscope_in(content: dict[str, Any]) -> MicroscopeFile:
    """The microscope that the content of a microscope.json describes.

    Raises:
        InputError: another schema, or as `read_microscope`.
    """
    check_schema(content.get("schema"), HISTORY, remedy="Restore the file, or render again.")
    found = validated(MicroscopeFile, content, remedy="Restore the key.")
    _check_agreement(found)
    if (
        found.full_scale is None
        and found.noise is not None
        and found.noise.bit_depth > _BITS_OF_MOST_FILES
    ):
        return found.changed(full_scale=found.noise.full_scale)
    return found


def _check_agreement(microscope: MicroscopeFile) -> None:
    """Refuse a file in which only one of two copies of a number was edited."""
    matrix, path = microscope.camera_matrix, microscope.viewing_path
    retina = microscope.retina_semi_axes_mm
    has_matrix = path is None and math.isfinite(microscope.pinhole_height_mm)
    if has_matrix != (matrix is not None):
        raise InputError(
            f"camera_matrix must be {'a matrix' if has_matrix else 'null'}; got "
            f"{shortened(matrix)}. It is null with a viewing_path, and without pinhole_height_mm "
            "(telecentric)."
        )
    if matrix is not None:
        focal = 1.0 / (microscope.inverse_working_distance * microscope.scale_mm_px)
        said = (matrix[0][0], matrix[1][1], matrix[0][2], matrix[1][2])
        implied = (focal, focal, *microscope.principal_point_px)
        if not np.allclose(said, implied, rtol=_AGREEMENT_TOLERANCE, atol=1e-6):
            listed = [", ".join(f"{value:.6g}" for value in four) for four in (said, implied)]
            raise InputError(
                f"camera_matrix has (fx, fy, cx, cy) = {listed[0]} px, but (pinhole_height_mm + "
                f"eye_radius_mm)/scale_mm_px and principal_point_px say {listed[1]} px. Change "
                "both alike."
            )
    if path is not None:
        if any(microscope.distortion):
            raise InputError(
                "distortion must be 0 with a viewing_path, which contains the lenses' distortion; "
                f"got {list(microscope.distortion)}. Undistort the images first."
            )
        own, of_path = microscope.inverse_working_distance, path.inverse_working_distance
        if not math.isclose(
            own, of_path, rel_tol=_AGREEMENT_TOLERANCE, abs_tol=_AGREEMENT_TOLERANCE
        ):
            raise InputError(
                f"pinhole_height_mm and eye_radius_mm say 1/(z_F + r) = {own:.6g}/mm, but "
                f"viewing_path says {of_path:.6g}/mm on the axis. Change both alike."
            )
    if retina is not None and microscope.plane_normal is not None:
        raise InputError(
            f"plane_normal {microscope.plane_normal} and retina_semi_axes_mm "
            f"{list(retina)} describe two walls. Remove one."
        )
    if retina and not math.isclose(
        retina[2], microscope.eye_radius_mm, rel_tol=_AGREEMENT_TOLERANCE
    ):
        raise InputError(
            f"eye_radius_mm must be the semi-axis along z of retina_semi_axes_mm, "
            f"{retina[2]:g} mm; got {microscope.eye_radius_mm:g} mm. Change both "
            "alike."
        )


def _from_calibration(content: dict[str, Any], given: Mapping[str, float | None]) -> MicroscopeFile:
    camera, size = camera_of(content)
    for name, value in given.items():
        if value is None or not math.isfinite(value):
            raise InputError(
                f"a camera calibration does not hold {name}. Give it with the file, in mm; got "
                f"{value}."
            )
    height, radius = (value or 0.0 for value in given.values())
    (fx, skew, u), (_, fy, v), _ = camera.matrix.tolist()
    if abs(fx - fy) > _SKEW_TOLERANCE * fx or abs(skew) > _SKEW_TOLERANCE * fx:
        raise InputError(
            f"camera_matrix must have square pixels without skew to {_SKEW_TOLERANCE:g} of fx; got "
            f"fx = {fx:g} px, fy = {fy:g} px, skew = {skew:g} px. Calibrate with "
            "cv2.CALIB_FIX_ASPECT_RATIO."
        )
    values = {
        "width_px": size[0],
        "height_px": size[1],
        "camera_matrix": camera.matrix.tolist(),
        "distortion": camera.distortion.tolist(),
        "distortion_model": camera.model,
        # Below the pole, the pinhole that the eye shows sees a pixel under the same angle.
        "scale_mm_px": abs(height + radius) / math.sqrt(fx * fy),
        "principal_point_px": (u, v),
        "pinhole_height_mm": height,
        "eye_radius_mm": radius,
        "curve": "linear",
    }
    return validated(MicroscopeFile, values, remedy="Calibrate the camera, or correct the value.")
