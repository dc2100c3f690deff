"""Distance from the area of the spot's ellipse for a known axis: model `area`."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from estimator.distance.range import Range
from estimator.distance.view import calibrated_view
from estimator.files import Calibration, MicroscopeFile
from estimator.image import Spot

if TYPE_CHECKING:
    import optics

_STEP = 1e-6  # of the differences, relative


@dataclass(frozen=True, kw_only=True, eq=False)
class _Seen:
    """What a spot is compared with."""

    wall: optics.Surface
    camera: optics.Camera
    half_angle: np.ndarray
    apex_offset: np.ndarray

    @classmethod
    def of(cls, microscope: MicroscopeFile, values: dict[str, float]) -> _Seen:
        view = calibrated_view(microscope, values)
        own = values.get("half_angle")
        return cls(
            wall=view.wall(),
            camera=view.ideal_microscope(),
            # Arrays: for plain numbers JAX would compile every time.
            half_angle=np.array(math.atan(1 / values["k"]) if own is None else own),
            apex_offset=np.array(values["b"]),
        )


class AreaDistances:
    """Finds distances by area under one microscope. Loads JAX; compiles once a process.

    Args:
        calibration: of a cone.
        microscope: as the file describes it; the spots lie in its undistorted image.
    """

    def __init__(self, calibration: Calibration, microscope: MicroscopeFile) -> None:
        values = dict(calibration.values)
        self._seen = _Seen.of(microscope, values)
        self._covariance = calibration.covariance
        # The same with each calibrated value a step larger, for the derivatives.
        self._steps = np.array([_STEP * max(abs(value), 1e-3) for value in values.values()])
        self._varied = [
            _Seen.of(microscope, values | {name: values[name] + step})
            if self._covariance[row, row] > 0
            else self._seen
            for row, (name, step) in enumerate(zip(values, self._steps, strict=True))
        ]
        # Compile now, so that the first image of a rig does not wait.
        x, y = microscope.principal_point_px
        self._distance(self._seen, np.array([x, y, 60.0, 50.0]), np.array([0.0, 0.0, -1.0]))

    def of(self, spot: Spot, *, axis: np.ndarray, axis_sigma_rad: float) -> Range:
        """The distance of a spot.

        Args:
            spot: in the undistorted image.
            axis: unit vector of the beam, (3,).
            axis_sigma_rad: standard deviation of the axis across itself.
        """
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

    def _distance(self, seen: _Seen, ellipse: np.ndarray, axis: np.ndarray) -> float:
        import optics

        x, y, major, minor = ellipse
        array: Any = np.array
        return float(
            optics.distance_by_area(
                optics.Ellipse(array([x, y]), array(major), array(minor), array(0.0)),
                seen.wall,
                seen.camera,
                axis=array(axis),
                half_angle=array(seen.half_angle),
                apex_offset=array(seen.apex_offset),
            )
        )
