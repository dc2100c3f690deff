"""Distance and pose by a cone: the camera's view, the ellipse's area, tip and axis."""

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from estimator.distance.range import Range, TipPose
from formats.calibration import Calibration
from formats.inputs import InputError
from formats.microscope import MicroscopeFile
from formats.spots import Spot

if TYPE_CHECKING:
    import optics


_OTHER = 1.5  # ratio of scales that no fit corrects: zooms differ by more, and rulers by less


def calibrated_view(microscope: MicroscopeFile, values: Mapping[str, float]) -> MicroscopeFile:
    """The microscope file with a calibration's own numbers in it.

    A calibrated pinhole replaces a viewing path, and the wall is then the sphere that it was fitted
    with.

    Args:
        values: of the calibration: `scale`, `eye_radius` and `inverse_working_distance`, if it has
            them, replace the microscope's.

    Raises:
        InputError: the calibrated scale is another microscope's, or another zoom's.
    """
    scale = float(values.get("scale", microscope.scale_mm_px))
    if not 1 / _OTHER < scale / microscope.scale_mm_px < _OTHER:
        raise InputError(
            f"the calibration has a scale of {scale:g} mm/px, the microscope file one of "
            f"{microscope.scale_mm_px:g} mm/px: it is of another microscope, or of another zoom. "
            "Give the file that was used for the calibration, or calibrate again."
        )
    radius = values.get("eye_radius", microscope.eye_radius_mm)
    own = 1.0 / (microscope.pinhole_height_mm + radius)
    kappa = values.get("inverse_working_distance", own)
    fitted = "inverse_working_distance" in values
    spherical = fitted or "eye_radius" in values
    return replace(
        microscope,
        scale_mm_px=scale,
        eye_radius_mm=float(radius),
        pinhole_height_mm=float(1.0 / kappa - radius) if kappa else math.inf,
        viewing_path=None if fitted else microscope.viewing_path,
        retina_semi_axes_mm=None if spherical else microscope.retina_semi_axes_mm,
    )


_STEP = 1e-6  # of the differences, relative


def _viewed_cone(microscope: MicroscopeFile, values: Mapping[str, float]) -> dict[str, Any]:
    """Wall, camera and cone, as `optics.distance_by_area` takes them."""
    view = calibrated_view(microscope, values)
    own = values.get("half_angle")
    return {
        "surface": view.wall(),
        "camera": view.ideal_microscope(),
        # Arrays: for plain numbers JAX would compile every time.
        "half_angle": np.array(math.atan(1 / values["k"]) if own is None else own),
        "apex_offset": np.array(values["b"]),
    }


class AreaDistances:
    """Finds distances by area in a microscope's undistorted image. Loads JAX; compiles once."""

    def __init__(self, calibration: Calibration, microscope: MicroscopeFile) -> None:
        values = dict(calibration.values)
        self._seen = _viewed_cone(microscope, values)
        self._covariance = calibration.covariance
        # The same with each calibrated value a step larger, for the derivatives.
        self._steps = np.array([_STEP * max(abs(value), 1e-3) for value in values.values()])
        self._varied = [
            _viewed_cone(microscope, values | {name: values[name] + step})
            if self._covariance[row, row] > 0
            else self._seen
            for row, (name, step) in enumerate(zip(values, self._steps, strict=True))
        ]
        # Compile now, so that the first image of a rig does not wait.
        x, y = microscope.principal_point_px
        self._distance(self._seen, np.array([x, y, 60.0, 50.0]), np.array([0.0, 0.0, -1.0]))

    def of(self, spot: Spot, *, axis: np.ndarray, axis_sigma_rad: float) -> Range:
        """The distance of a spot, see `Ranger.distance`."""
        ellipse = np.array([spot.x_px, spot.y_px, spot.semi_major_px, spot.semi_minor_px])
        distance = self._distance(self._seen, ellipse, axis)
        steps = _STEP * np.maximum(np.abs(ellipse), 1.0)
        by_spot = [self._distance(self._seen, ellipse + row, axis) for row in np.diag(steps)]
        across = np.linalg.svd(axis[None])[2][1:]
        turned = [axis + _STEP * side for side in across]
        by_axis = [self._distance(self._seen, ellipse, a / np.linalg.norm(a)) for a in turned]
        by_value = [self._distance(seen, ellipse, axis) for seen in self._varied]
        of_spot = (np.array(by_spot) - distance) / steps
        of_value = (np.array(by_value) - distance) / self._steps
        of_axis = (np.array(by_axis) - distance) / _STEP
        variance = of_spot @ spot.covariance[:4, :4] @ of_spot
        variance += of_value @ self._covariance @ of_value
        variance += axis_sigma_rad**2 * (of_axis @ of_axis)
        return Range(distance_mm=distance, sigma_mm=math.sqrt(variance))

    def _distance(self, seen: dict[str, Any], ellipse: np.ndarray, axis: np.ndarray) -> float:
        import optics

        x, y, major, minor = ellipse
        array: Any = np.array
        measured = optics.Ellipse(array([x, y]), array(major), array(minor), array(0.0))
        return float(optics.distance_by_area(measured, axis=array(axis), **seen))


UNKNOWN_SIGMA_PX = 0.5
"""Standard deviation of the ellipse if a mode measures none; weighs it against the axis."""

_NO_WEIGHT_RAD = 1e6  # standard deviation of an unknown axis
_EXACT_RAD = 1e-3
"""Least standard deviation of an axis: without any doubt of it the search misses the ellipse."""
_CIRCLE = 1e-9  # difference of the axes, relative, below which an ellipse has no angle
_SAME_COST = 9.0  # difference of cost of two poses that three standard deviations do not separate


class ConePoses:
    """Finds the poses of a cone in a microscope's undistorted image. Loads JAX; compiles once.

    Args:
        half_angle: of the cone, rad.
        apex_offset: b, mm.
    """

    def __init__(
        self, microscope: MicroscopeFile, *, half_angle: float, apex_offset: float
    ) -> None:
        self._wall = microscope.wall()
        self._view = microscope.ideal_microscope()
        self._cone = {"half_angle": np.asarray(half_angle), "apex_offset": np.asarray(apex_offset)}
        # Compile now, so that the first image of a rig does not wait.
        x, y = microscope.principal_point_px
        self._estimate(np.array([x, y, 60.0, 50.0, 0.0]), np.eye(5), None, 0.0)

    def of(
        self, spot: Spot, *, axis: np.ndarray | None, axis_sigma_rad: float
    ) -> tuple[tuple[TipPose, TipPose], bool, float]:
        """The likelier pose, given ellipse and axis, and the one with the incidence reversed.

        Also whether ellipse and axis do not decide between the two; and the distance's standard
        deviation from the spot's covariance, mm, NaN if that is unknown.
        """
        known = bool(np.isfinite(spot.covariance).all())
        covariance = spot.covariance
        if not known:  # the angle may move the contour as far as the centre and the axes do
            elongation = max(spot.semi_major_px - spot.semi_minor_px, _CIRCLE * spot.semi_major_px)
            covariance = UNKNOWN_SIGMA_PX**2 * np.diag([1.0, 1.0, 1.0, 1.0, elongation**-2])
        axis_sigma_rad = max(axis_sigma_rad, _EXACT_RAD)
        found = self._estimate(np.array(spot.ellipse), covariance, axis, axis_sigma_rad)
        best, mirror = (
            TipPose(
                tip_mm=np.asarray(pose.tip),
                axis=np.asarray(pose.axis),
                distance_mm=float(pose.distance),
            )
            for pose in (found.best, found.mirror)
        )
        alike = float(found.mirror.cost - found.best.cost) < _SAME_COST
        return (best, mirror), alike, float(found.best.distance_error) if known else np.nan

    def _estimate(
        self,
        ellipse: np.ndarray,
        covariance: np.ndarray,
        axis: np.ndarray | None,
        axis_sigma_rad: float,
    ) -> "optics.PoseEstimate":
        import optics

        # Without an axis, pass one without weight: both cases share one compilation.
        if axis is None:
            axis, axis_sigma_rad = np.array([0.0, 0.0, -1.0]), _NO_WEIGHT_RAD
        # Pass NumPy arrays: for plain numbers JAX would compile every time.
        array: Any = np.asarray
        return optics.pose_from_ellipse(
            optics.Ellipse(array(ellipse[:2]), *map(array, ellipse[2:])),
            self._wall,
            self._view,
            covariance=array(covariance),
            prior=optics.DirectionPrior(array(axis), array(axis_sigma_rad)),
            **self._cone,
        )
