"""Distance and pose by a cone: the camera's view, the ellipse's area, tip and axis."""

import functools
import math
from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from eyespot.estimator.detector.tuning import Sharp
from eyespot.estimator.distance.range import Range, TipPose
from eyespot.formats.calibration import Calibration
from eyespot.formats.inputs import InputError
from eyespot.formats.microscope import MicroscopeFile
from eyespot.formats.spot import EVEN_LIGHT, Spot

if TYPE_CHECKING:
    from eyespot import optics


_OTHER_SCALE_RATIO = 1.5
"""Ratio of scales that no fit corrects: zooms differ by more, and rulers by less."""


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
    if not 1 / _OTHER_SCALE_RATIO < scale / microscope.scale_mm_px < _OTHER_SCALE_RATIO:
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
    return microscope.changed(
        scale_mm_px=scale,
        eye_radius_mm=float(radius),
        pinhole_height_mm=float(1.0 / kappa - radius) if kappa else math.inf,
        viewing_path=None if fitted else microscope.viewing_path,
        retina_semi_axes_mm=None if spherical else microscope.retina_semi_axes_mm,
    )


_KERNEL_SPREAD = 0.15
"""Relative standard deviation of the shift by a blur of unknown shape: 0.85 of a Gaussian's with
the same edge width for a disc out of focus, 1.27 for light that falls exponentially."""


def unblurred(spot: Spot) -> Spot:
    r"""The spot with the contour that a sharp cone's light had before it was blurred.

    A cone that meets the wall obliquely is brighter on one side. A blur moves the half of the peak
    inwards on the other side, and no side's half of its own light, see `Spot.own_half`.

    Where an edge has the curvature $\kappa$, a blur s moves half of its light inwards by
    $\kappa s^2/2$, s being the standard deviation along the edge. The blur is taken from the edge's
    width; the next term, $\kappa^3 s^4$, is below the errors up to a blur of a third of the radius.
    A spot of a mode that measures no width stays as it is.
    """
    if math.isnan(spot.edge_width_px):
        return spot
    own = spot.own_half
    major, minor = spot.semi_major_px * own.growth, spot.semi_minor_px * own.growth
    blur = max(spot.edge_width_px**2 - Sharp.PIXEL_EDGE_PX**2, 0.0)
    shift = blur / 2 * np.array([major / minor**2, minor / major**2])
    covariance = spot.covariance.copy()
    covariance[[0, 1], [0, 1]] += own.more_variance_px2
    axes = spot.semi_major_px, spot.semi_minor_px
    covariance[2:4, 2:4] -= own.less_growth_variance * np.outer(axes, axes)
    covariance[2:4, 2:4] += np.outer(shift, shift) * _KERNEL_SPREAD**2
    major, minor = np.array([major, minor]) + shift
    return replace(
        spot,
        x_px=spot.x_px + own.right_px,
        y_px=spot.y_px + own.down_px,
        semi_major_px=major,
        semi_minor_px=minor,
        covariance=covariance,
        own_half=EVEN_LIGHT,
    )


_DIFFERENCE_STEP = 1e-6  # of one-sided differences


class AreaDistances:
    """Finds distances by area in a microscope's undistorted image. Loads JAX; compiles once."""

    def __init__(self, calibration: Calibration, microscope: MicroscopeFile) -> None:
        self._calibration, self._microscope = calibration, microscope
        # Each frame asks for the same values: the calibrated ones, and each of them a step larger.
        self._seen = functools.cache(self._seen_with)
        # Compile now, so that the first image of a rig does not wait.
        ellipse = np.array([*microscope.principal_point_px, 60.0, 50.0])
        self._distance(ellipse, np.array([0.0, 0.0, -1.0]), [*calibration.values.values()])

    def of(self, spot: Spot, *, axis: np.ndarray, axis_sigma_rad: float) -> Range:
        """The distance of a spot, see `Ranger.distance`; its sigma propagated by differences."""
        from scipy.linalg import block_diag

        across = np.linalg.svd(axis[None])[2][1:]
        ellipse, turns, values = spot.ellipse[:4], (0.0, 0.0), self._calibration.values.values()
        given = np.array([*ellipse, *turns, *values])
        steps = _DIFFERENCE_STEP * np.maximum(
            np.abs(given), np.repeat([1.0, 1e-3], [6, len(values)])
        )
        distance, *varied = (
            self._distance(row[:4], axis + row[4:6] @ across, row[6:].tolist())
            for row in given + np.vstack([np.zeros(given.size), np.diag(steps)])
        )
        slopes = (np.array(varied) - distance) / steps
        of_axis = axis_sigma_rad**2 * np.eye(2)
        covariance = block_diag(spot.covariance[:4, :4], of_axis, self._calibration.covariance)
        return Range(distance_mm=distance, sigma_mm=math.sqrt(slopes @ covariance @ slopes))

    def _distance(self, ellipse: np.ndarray, axis: np.ndarray, values: list[float]) -> float:
        from eyespot import optics

        # Arrays: for plain numbers JAX would compile every time.
        array: Any = np.array
        x, y, major, minor = ellipse
        measured = optics.Ellipse(array([x, y]), array(major), array(minor), array(0.0))
        unit = array(axis / np.linalg.norm(axis))
        return float(optics.distance_by_area(measured, axis=unit, **self._seen(*values)))

    def _seen_with(self, *values: float) -> dict[str, Any]:
        """Wall, camera and cone with calibrated values, as `optics.distance_by_area` takes them."""
        named = dict(zip(self._calibration.values, values, strict=True))
        view, own = calibrated_view(self._microscope, named), named.get("half_angle")
        return {
            "surface": view.wall(),
            "camera": view.ideal_microscope(),
            "half_angle": np.array(math.atan(1 / named["k"]) if own is None else own),
            "apex_offset": np.array(named["b"]),
        }


UNKNOWN_SIGMA_PX = 0.5
"""Standard deviation of the ellipse if a mode measures none; weighs it against the axis."""

_NO_WEIGHT_RAD = 1e6  # standard deviation of an unknown axis
_EXACT_RAD = 1e-3
"""Least standard deviation of an axis: without any doubt of it the search misses the ellipse."""
_CIRCLE_TOLERANCE = 1e-9  # difference of the axes, relative, below which an ellipse has no angle
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
            elongation = max(
                spot.semi_major_px - spot.semi_minor_px, _CIRCLE_TOLERANCE * spot.semi_major_px
            )
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
        from eyespot import optics

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
