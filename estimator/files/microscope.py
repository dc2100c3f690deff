"""What is known of a microscope: the stack's microscope.json, or a calibration file of OpenCV.

Both end in one `MicroscopeFile`. OpenCV's files know the camera but not the eye: the pinhole's
height and the eye's radius come with the call.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from estimator.files.opencv import opencv_camera
from estimator.image import Camera, Response

if TYPE_CHECKING:
    import optics

SCHEMA = 1
_SAME = 1e-6  # relative; what a file says twice agrees to the digits that JSON keeps
_SQUARE = 1e-3  # relative; half of it in the spot's radius is 6 um at d - b = 11 mm


class MicroscopeFileError(ValueError):
    """A file does not describe a microscope that this version can use; the text says why."""


@dataclass(frozen=True, kw_only=True, eq=False)
class MicroscopeFile:
    """A pinhole on the axis of the eye, looking down at the retinal pole.

    Attributes:
        width_px: of the frames.
        height_px: of the frames.
        camera_matrix: K of OpenCV, 3x3, px; None for a telecentric microscope.
        distortion: coefficients in OpenCV's order.
        scale_mm_px: delta at the height of the pole.
        principal_point_px: (u0, v0); may lie outside the frame.
        pinhole_height_mm: z_F above the eyeball's centre; infinite if telecentric.
        eye_radius_mm: r; the pole lies at -r.
        response: how the frames' values follow from light; linear where the file does not say.
        paper_exposure_s: exposure time of the stack's frames of fixed exposure; None where the
            file does not say.
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

    def __post_init__(self) -> None:
        """Reject what no microscope can have."""
        for name in ("width_px", "height_px", "scale_mm_px", "eye_radius_mm"):
            value = getattr(self, name)
            if not 0 < value < math.inf:
                raise MicroscopeFileError(f"{name} must be positive and finite; got {value}.")
        if not self.pinhole_height_mm > -self.eye_radius_mm:
            raise MicroscopeFileError(
                "pinhole_height_mm must lie above the retinal pole at -eye_radius_mm; got "
                f"{self.pinhole_height_mm} mm with eye_radius_mm = {self.eye_radius_mm}. It counts "
                "from the eyeball's centre, up."
            )
        if not np.isfinite(self.principal_point_px).all():
            raise MicroscopeFileError(
                f"principal_point_px must be finite; got {self.principal_point_px}."
            )

    @property
    def inverse_working_distance(self) -> float:
        """kappa = 1/(z_F + r), 1/mm; 0 if telecentric."""
        return 1.0 / (self.pinhole_height_mm + self.eye_radius_mm)

    def camera(self) -> Camera | None:
        """For `SubpixelSettings(camera=...)`; None where there is no distortion to take out."""
        if self.camera_matrix is None or not self.distortion.any():
            return None
        return Camera(matrix=self.camera_matrix, distortion=self.distortion)

    def ideal_microscope(self) -> optics.Microscope:
        """The pinhole without distortion, in whose image undistorted spots lie. Loads JAX."""
        import optics

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
    """Read a microscope from a stack's microscope.json or from a calibration file of OpenCV.

    Args:
        path: of the file.
        pinhole_height_mm: z_F above the eyeball's centre, for OpenCV files, which do not hold it.
        eye_radius_mm: r, for OpenCV files, which do not hold it.

    Raises:
        MicroscopeFileError: the file is neither, of another schema, contradicts itself, lacks
            something, or already holds what was given; the text says which key.
        OSError: the file cannot be read.
    """
    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise MicroscopeFileError(f"{path}: not a text file: {error}.") from error
    given = {"pinhole_height_mm": pinhole_height_mm, "eye_radius_mm": eye_radius_mm}
    try:
        content = _json(text)
        if content is not None and "schema" in content:
            twice = [name for name, value in given.items() if value is not None]
            if twice:
                raise MicroscopeFileError(
                    f"{twice[0]} stands in the file. Leave it out of the call, or edit the file."
                )
            return _ours(content)
        return _from_opencv(text, given)
    except ValueError as error:
        raise MicroscopeFileError(f"{path}: {error}") from error


def _json(text: str) -> dict[str, Any] | None:
    try:
        content = json.loads(text)
    except json.JSONDecodeError:
        return None
    return content if isinstance(content, dict) else None


def _ours(content: dict[str, Any]) -> MicroscopeFile:
    if content["schema"] != SCHEMA:
        raise MicroscopeFileError(
            f"schema is {content['schema']!r}; this version reads {SCHEMA}. Render the stack again "
            "with this version, or read it with the one that wrote it."
        )
    height = content.get("pinhole_height_mm")
    exposure = content.get("paper_exposure_s")
    microscope = MicroscopeFile(
        width_px=int(_number(content, "width_px")),
        height_px=int(_number(content, "height_px")),
        camera_matrix=_matrix(content, telecentric=height is None),
        distortion=_array(content, "distortion", None),
        scale_mm_px=_number(content, "scale_mm_px"),
        principal_point_px=_pair(_array(content, "principal_point_px", (2,))),
        pinhole_height_mm=math.inf if height is None else _number(content, "pinhole_height_mm"),
        eye_radius_mm=_number(content, "eye_radius_mm"),
        response=_response(content.get("response")),
        paper_exposure_s=None if exposure is None else _number(content, "paper_exposure_s"),
    )
    _agrees_with_its_matrix(microscope)
    return microscope


def _matrix(content: dict[str, Any], *, telecentric: bool) -> np.ndarray | None:
    if telecentric:
        if content.get("camera_matrix") is not None:
            raise MicroscopeFileError(
                "pinhole_height_mm is missing (telecentric), so that camera_matrix must be null. "
                "Give the pinhole's height, or remove the matrix."
            )
        return None
    return _array(content, "camera_matrix", (3, 3))


def _agrees_with_its_matrix(microscope: MicroscopeFile) -> None:
    """Whoever edits one of two copies of a number is told."""
    matrix = microscope.camera_matrix
    if matrix is None:
        return
    focal = 1.0 / (microscope.inverse_working_distance * microscope.scale_mm_px)
    said = (matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2])
    implied = (focal, focal, *microscope.principal_point_px)
    if not np.allclose(said, implied, rtol=_SAME, atol=1e-6):
        raise MicroscopeFileError(
            f"camera_matrix has (fx, fy, cx, cy) = {_listed(said)} px, but (pinhole_height_mm + "
            f"eye_radius_mm)/scale_mm_px and principal_point_px say {_listed(implied)} px. Change "
            "both alike."
        )


def _from_opencv(text: str, given: dict[str, float | None]) -> MicroscopeFile:
    seen = opencv_camera(text)
    height, radius = (_given(name, value) for name, value in given.items())
    matrix = seen.camera.matrix
    fx, fy, skew = matrix[0, 0], matrix[1, 1], matrix[0, 1]
    if abs(fx - fy) > _SQUARE * fx or abs(skew) > _SQUARE * fx:
        raise MicroscopeFileError(
            f"camera_matrix must have square pixels without skew to {_SQUARE:g} of fx; got fx = "
            f"{fx:g} px, fy = {fy:g} px, skew = {skew:g} px. Calibrate with "
            "cv2.CALIB_FIX_ASPECT_RATIO."
        )
    return MicroscopeFile(
        width_px=seen.width_px,
        height_px=seen.height_px,
        camera_matrix=matrix,
        distortion=seen.camera.distortion,
        scale_mm_px=(height + radius) / math.sqrt(fx * fy),
        principal_point_px=_pair(matrix[:2, 2]),
        pinhole_height_mm=height,
        eye_radius_mm=radius,
    )


def _given(name: str, value: float | None) -> float:
    if value is None or not math.isfinite(value):
        raise MicroscopeFileError(
            f"a calibration file of OpenCV does not hold {name}. Give it with the file, in mm; got "
            f"{value}."
        )
    return value


def _number(content: dict[str, Any], key: str) -> float:
    value = content.get(key)
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise MicroscopeFileError(f"{key} must be a number; got {value!r}.")
    return float(value)


def _array(content: dict[str, Any], key: str, shape: tuple[int, ...] | None) -> np.ndarray:
    try:
        array = np.asarray(content.get(key), float)
    except (TypeError, ValueError):
        array = np.asarray(math.nan)
    if not np.isfinite(array).all() or (array.ndim != 1 if shape is None else array.shape != shape):
        wanted = "a list" if shape is None else "x".join(map(str, shape))
        raise MicroscopeFileError(
            f"{key} must be finite numbers ({wanted}); got {content.get(key)!r}."
        )
    return array


def _pair(values: np.ndarray) -> tuple[float, float]:
    first, second = values.tolist()
    return first, second


def _response(value: object) -> Response:
    """The scene file's names: linear, srgb, or g for the curve x^(1/g)."""
    if value == "linear" or value == "srgb":
        return Response(curve=value)
    if isinstance(value, int | float) and not isinstance(value, bool):
        return Response(curve="gamma", gamma=float(value))
    raise MicroscopeFileError(
        f"response must be linear, srgb or the exponent of a gamma curve; got {value!r}."
    )


def _listed(values: tuple[float, ...]) -> str:
    return ", ".join(f"{value:.6g}" for value in values)
