"""Camera calibrations as OpenCV and ROS write them.

YAML, JSON and XML of cv2.FileStorage, and the YAML of ROS's camera_calibration, which lacks
FileStorage's first line and its types.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import cv2
import numpy as np

from estimator.image import Camera
from optics import InputError

_NAMES = {
    "image_width": ("image_width", "image_Width", "width"),
    "image_height": ("image_height", "image_Height", "height"),
    "camera_matrix": ("camera_matrix", "Camera_Matrix", "cameraMatrix", "CameraMatrix", "K"),
    "distortion_coefficients": (
        "distortion_coefficients",
        "Distortion_Coefficients",
        "dist_coeffs",
        "distCoeffs",
        "dist_coeff",
        "D",
    ),
}
"""Keys of OpenCV's samples, ROS and common tutorials for the same quantities."""


class CameraOfFile(NamedTuple):
    """A camera and the size of its frames, px."""

    width_px: int
    height_px: int
    camera: Camera


def opencv_camera(text: str) -> CameraOfFile:
    """Read a calibration.

    Args:
        text: of the file.

    Raises:
        InputError: cv2.FileStorage does not read it, or a key is missing or not a number; the
            message names the key.
    """
    storage = _storage(text)
    return CameraOfFile(
        width_px=_count(storage, "image_width"),
        height_px=_count(storage, "image_height"),
        camera=Camera(
            matrix=_stored(storage, "camera_matrix"),
            distortion=_stored(storage, "distortion_coefficients"),
        ),
    )


def _storage(text: str) -> cv2.FileStorage:
    # ROS writes the same YAML without the first line that cv2 requires.
    headed = (
        text if text.lstrip().startswith(("%YAML", "{", "<?xml")) else f"%YAML:1.0\n---\n{text}"
    )
    try:
        storage = cv2.FileStorage(headed, cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)
        readable = storage.isOpened() and not storage.root().empty()
    except (cv2.error, SystemError):  # its constructor wraps the first in the second
        readable = False
    if not readable:
        raise InputError(
            "neither a microscope.json (no `schema` in it) nor a file that cv2.FileStorage reads. "
            "Write it with cv2.FileStorage, or take the one from a stack."
        )
    return storage


def _count(storage: cv2.FileStorage, name: str) -> int:
    value = _stored(storage, name)
    if value.size != 1 or not value == np.floor(value):
        raise InputError(f"{name} must be one whole number; got {value.tolist()}.")
    return int(value)


def _stored(storage: cv2.FileStorage, name: str) -> np.ndarray:
    """The values under one of a key's spellings: a matrix, ROS's map with `data`, or a number."""
    for spelling in _NAMES[name]:
        node = storage.getNode(spelling)
        if node.empty():
            continue
        if node.isReal() or node.isInt():
            return np.asarray(node.real())
        # cv2 marks its own matrices with their type.
        if node.isMap() and "dt" in node.keys():
            return np.asarray(node.mat(), float)
        return _plain(node, spelling)
    raise InputError(
        f"{name} is missing (looked for {', '.join(_NAMES[name])}). Add it to the file."
    )


def _plain(node: cv2.FileNode, spelling: str) -> np.ndarray:
    """Numbers of a sequence (nested or not), or of a map of rows, cols and data."""
    if node.isMap():
        shape = tuple(int(node.getNode(key).real()) for key in ("rows", "cols"))
        values = _plain(node.getNode("data"), spelling)
        if math.prod(shape) != values.size:
            raise InputError(
                f"{spelling} has {values.size} numbers, but rows and cols say {shape}."
            )
        return values.reshape(shape)
    parts = [node.at(index) for index in range(node.size())] if node.isSeq() else []
    if not parts or any(part.isString() for part in parts):
        raise InputError(f"{spelling} must hold numbers.")
    rows = [np.asarray(p.real()) if not p.isSeq() else _plain(p, spelling) for p in parts]
    if len({row.shape for row in rows}) != 1:
        raise InputError(f"{spelling} must have rows of equal length.")
    return np.stack(rows)
