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
from optics import InputError, shortened

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

_MOST = 2**20  # rows, columns and pixels of a side
_DEEPEST = 4  # levels of lists
_MOST_BRACKETS = 10_000  # with all of a calibration's views
_DEEPEST_INDENT = 200  # OpenCV indents by three or four a level


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
    try:
        return CameraOfFile(
            width_px=_count(storage, "image_width"),
            height_px=_count(storage, "image_height"),
            camera=Camera(
                matrix=_stored(storage, "camera_matrix"),
                distortion=_stored(storage, "distortion_coefficients"),
            ),
        )
    except cv2.error as error:
        said = " ".join(str(error.err or error).split())[:200]
        raise InputError(f"OpenCV cannot read its own format: {said}. Write it again.") from error


def _storage(text: str) -> cv2.FileStorage:
    _check_size(text)
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


def _check_size(text: str) -> None:
    """Refuse what OpenCV's parser, which recurses without limit, could not read."""
    brackets = sum(map(text.count, "[{<"))
    indented = max((len(line) - len(line.lstrip()) for line in text.splitlines()), default=0)
    if brackets > _MOST_BRACKETS or indented > _DEEPEST_INDENT or "\0" in text:
        raise InputError(
            f"no camera calibration: it has more than {_MOST_BRACKETS:,} brackets, lines that are "
            f"indented by more than {_DEEPEST_INDENT}, or NUL. Check that it is the right file."
        )


def _count(storage: cv2.FileStorage, name: str) -> int:
    value = _stored(storage, name)
    if value.size != 1 or not 0 < value <= _MOST or not value == np.floor(value):
        raise InputError(
            f"{name} must be one whole number, at most {_MOST:,}; got {shortened(value.tolist())}."
        )
    return int(value.item())


def _stored(storage: cv2.FileStorage, name: str) -> np.ndarray:
    """The values under one of a key's spellings: a matrix, ROS's map with `data`, or a number."""
    for spelling in _NAMES[name]:
        node = storage.getNode(spelling)
        if not node.empty():
            return np.asarray(node.real()) if _is_number(node) else _plain(node, spelling, 0)
    raise InputError(
        f"{name} is missing (looked for {', '.join(_NAMES[name])}). Add it to the file."
    )


def _plain(node: cv2.FileNode, spelling: str, level: int) -> np.ndarray:
    """Numbers of a sequence (nested or not), or of a map of rows, cols and data.

    OpenCV's own matrices are such maps. They are not read by OpenCV, which takes the memory that
    rows and cols ask for before it looks at data.
    """
    if node.isMap() and level == 0:
        shape = _shape(node, spelling)
        values = _plain(node.getNode("data"), spelling, level + 1)
        if math.prod(shape) != values.size:
            raise InputError(
                f"{spelling} has {values.size} numbers, but rows and cols say "
                f"{' x '.join(map(str, shape))}."
            )
        return values.reshape(shape)
    parts = _items(node) or ([node] if _is_number(node) else [])
    if not parts or level > _DEEPEST:
        raise InputError(f"{spelling} must hold numbers.")
    if all(map(_is_number, parts)):
        return np.array([part.real() for part in parts])
    rows_found = [_plain(part, spelling, level + 1) for part in parts if part.isSeq()]
    if len(rows_found) != len(parts):
        raise InputError(f"{spelling} must hold numbers.")
    if len({row.shape for row in rows_found}) != 1:
        raise InputError(f"{spelling} must have rows of equal length.")
    return np.stack(rows_found)


def _shape(node: cv2.FileNode, spelling: str) -> tuple[int, ...]:
    """Of a map: its rows and cols, or the one to four `sizes` of OpenCV 5."""
    sizes = node.getNode("sizes")
    if sizes.empty():
        parts = [node.getNode(key) for key in ("rows", "cols")]
    else:
        parts = _items(sizes)[:_DEEPEST] or [sizes]  # XML has a number for a list of one
    found = [part.real() if _is_number(part) else math.nan for part in parts]
    if not all(0 < value <= _MOST and value == math.floor(value) for value in found):
        raise InputError(f"rows and cols of {spelling} must be whole numbers, at least 1.")
    return tuple(map(int, found))


def _items(node: cv2.FileNode) -> list[cv2.FileNode]:
    return [node.at(index) for index in range(node.size())] if node.isSeq() else []


def _is_number(node: cv2.FileNode) -> bool:
    return not node.empty() and bool(node.isInt() or node.isReal())
