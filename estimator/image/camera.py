"""A camera's matrix and lens distortion, as OpenCV defines them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

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
        distortion: 4, 5, 8, 12 or 14 coefficients in OpenCV's order; 4 of equidistant.
        model: brown is that of cv2.calibrateCamera; equidistant that of cv2.fisheye (Kannala and
            Brandt, 2006): r = f theta (1 + k1 theta^2 + ... + k4 theta^8) at the angle theta.
    """

    matrix: np.ndarray
    distortion: np.ndarray
    model: Literal["brown", "equidistant"] = "brown"

    def __post_init__(self) -> None:
        """Refuse matrices and coefficients that OpenCV cannot use."""
        matrix, distortion = np.asarray(self.matrix, float), np.asarray(self.distortion, float)
        if matrix.shape != (3, 3) or not np.isfinite(matrix).all() or matrix[0, 0] == 0:
            raise InputError(
                "camera_matrix must be a finite 3x3 matrix with focal lengths other than 0;"
                f" got shape {matrix.shape}. Calibrate the camera."
            )
        counts = (4,) if self.model == "equidistant" else (4, 5, 8, 12, 14)
        if distortion.size not in counts or not np.isfinite(distortion).all():
            raise InputError(
                f"the distortion must have {' or '.join(map(str, counts))} finite coefficients;"
                f" got {distortion.size}. Calibrate the camera."
            )
        object.__setattr__(self, "matrix", matrix)
        object.__setattr__(self, "distortion", distortion.ravel())

    def undistorted(self, points: np.ndarray) -> np.ndarray:
        """The points in the image of an ideal pinhole with the same matrix, (n, 2), px."""
        undistort = cv2.undistortPoints if self.model == "brown" else cv2.fisheye.undistortPoints
        return undistort(points.reshape(-1, 1, 2), self.matrix, self.distortion, P=self.matrix)[
            :, 0
        ]

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
        project = cv2.projectPoints if self.model == "brown" else cv2.fisheye.projectPoints
        rays = rays.T.reshape(-1, 1, 3)
        seen, _ = project(rays, np.zeros(3), np.zeros(3), self.matrix, self.distortion)
        return seen[:, 0]

    def distorted(self, x: float, y: float) -> tuple[float, float]:
        """A point of the ideal image in this camera's image, px."""
        u, v = self.all_distorted(np.array([[x, y]]))[0].tolist()
        return u, v
