"""A camera's matrix and lens distortion, as OpenCV defines them."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from optics import InputError

_UNDONE_PX = 1.0  # OpenCV's few iterations end within this where there is an inverse


@dataclass(frozen=True, kw_only=True, eq=False)
class Camera:
    """Removes a lens's distortion from image points.

    Attributes:
        matrix: 3x3 camera matrix K, px; its focal lengths are negative if the pinhole, seen through
            the eye, lies behind the scene.
        distortion: 4, 5, 8, 12 or 14 coefficients in OpenCV's order.
    """

    matrix: np.ndarray
    distortion: np.ndarray

    def __post_init__(self) -> None:
        """Refuse matrices and coefficients that OpenCV cannot use."""
        matrix, distortion = np.asarray(self.matrix, float), np.asarray(self.distortion, float)
        if matrix.shape != (3, 3) or not np.isfinite(matrix).all() or matrix[0, 0] == 0:
            raise InputError(
                "Camera(matrix=...) must be a finite 3x3 matrix with focal lengths other than 0;"
                f" got shape {matrix.shape}."
            )
        if distortion.size not in (4, 5, 8, 12, 14) or not np.isfinite(distortion).all():
            raise InputError(
                "Camera(distortion=...) must have 4, 5, 8, 12 or 14 finite coefficients;"
                f" got {distortion.size}."
            )
        object.__setattr__(self, "matrix", matrix)
        object.__setattr__(self, "distortion", distortion.ravel())

    def undistorted(self, points: np.ndarray) -> np.ndarray:
        """The points in the image of an ideal pinhole with the same matrix, (n, 2), px."""
        return cv2.undistortPoints(
            points.reshape(-1, 1, 2), self.matrix, self.distortion, P=self.matrix
        )[:, 0]

    def can_undistort(self, points: np.ndarray) -> bool:
        """Whether the distortion has an inverse at points, (n, 2), px.

        A polynomial that was fitted to a part of the image turns back outside of it: several points
        of the ideal image are seen at one place, and OpenCV's iteration finds any or none of them.
        """
        back = self.all_distorted(self.undistorted(points))
        return bool(np.abs(back - points).max() < _UNDONE_PX)

    def all_distorted(self, points: np.ndarray) -> np.ndarray:
        """Points of the ideal image in this camera's image, (n, 2), px."""
        rays = np.linalg.solve(self.matrix, np.column_stack([points, np.ones(len(points))]).T)
        zero = np.zeros(3)
        seen, _ = cv2.projectPoints(rays.T, zero, zero, self.matrix, self.distortion)
        return seen[:, 0]

    def distorted(self, x: float, y: float) -> tuple[float, float]:
        """A point of the ideal image in this camera's image, px."""
        u, v = self.all_distorted(np.array([[x, y]]))[0].tolist()
        return u, v
