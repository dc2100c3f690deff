"""Tip and axis of the sharp cone whose spot on the wall has a given ellipse: model `exact`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from estimator.distance.range import TipPose
from estimator.files import MicroscopeFile
from estimator.image import Spot

if TYPE_CHECKING:
    import optics

UNKNOWN_SIGMA_PX = 0.5
"""Standard deviation of the ellipse if a mode measures none; weighs it against the axis."""

_NO_WEIGHT_RAD = 1e6  # standard deviation of an unknown axis
_EXACT_RAD = 1e-3
"""Least standard deviation of an axis: without any doubt of it the search misses the ellipse."""
_CIRCLE = 1e-9  # difference of the axes, relative, below which an ellipse has no angle
_SAME_COST = 9.0  # difference of cost of two poses that three standard deviations do not separate


@dataclass(frozen=True, kw_only=True, eq=False)
class PosePair:
    """Two poses whose spot on the wall has the ellipse, at least nearly.

    Attributes:
        best: the likelier one, given the ellipse and the axis.
        mirror: the other one, with the incidence reversed.
        alike: whether ellipse and axis do not decide between the two.
        sigma_mm: of the distance, from the spot's covariance; NaN if that is unknown.
    """

    best: TipPose
    mirror: TipPose
    alike: bool
    sigma_mm: float


class ConePoses:
    """Finds the poses of one cone under one microscope. Loads JAX; compiles once a process.

    Args:
        microscope: the spots lie in its undistorted image.
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

    def of(self, spot: Spot, *, axis: np.ndarray | None, axis_sigma_rad: float) -> PosePair:
        """The poses of a spot.

        Args:
            spot: in the undistorted image.
            axis: unit vector of the beam, (3,), weighed against the ellipse; None if unknown.
            axis_sigma_rad: standard deviation of the axis across itself.
        """
        known = bool(np.isfinite(spot.covariance).all())
        axis_sigma_rad = max(axis_sigma_rad, _EXACT_RAD)
        ellipse = np.array(
            [spot.x_px, spot.y_px, spot.semi_major_px, spot.semi_minor_px, spot.angle_rad]
        )
        found = self._estimate(ellipse, _covariance(spot, known), axis, axis_sigma_rad)
        return PosePair(
            best=_tip_pose(found.best),
            mirror=_tip_pose(found.mirror),
            alike=float(found.mirror.cost - found.best.cost) < _SAME_COST,
            sigma_mm=float(found.best.distance_error) if known else np.nan,
        )

    def _estimate(
        self,
        ellipse: np.ndarray,
        covariance: np.ndarray,
        axis: np.ndarray | None,
        axis_sigma_rad: float,
    ) -> optics.PoseEstimate:
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


def _covariance(spot: Spot, known: bool) -> np.ndarray:
    if known:
        return spot.covariance
    elongation = max(spot.semi_major_px - spot.semi_minor_px, _CIRCLE * spot.semi_major_px)
    # The angle may move the contour as far as the centre and the axes do.
    return UNKNOWN_SIGMA_PX**2 * np.diag([1.0, 1.0, 1.0, 1.0, elongation**-2])


def _tip_pose(pose: optics.BeamPose) -> TipPose:
    return TipPose(
        tip_mm=np.asarray(pose.tip), axis=np.asarray(pose.axis), distance_mm=float(pose.distance)
    )
