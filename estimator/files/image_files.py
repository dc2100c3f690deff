"""Decodes image files that anyone may have written, after a look at their size in pixels."""

from __future__ import annotations

import io
import warnings
from pathlib import Path

import cv2
import numpy as np

from estimator.files.whole_files import damage_reported
from optics import InputError, read_data

MOST_PIXELS = 2**26
"""Most pixels of an image: 8192 x 8192, the largest that a scene file can ask for."""

_MOST_BYTES = 2**30  # that many pixels as RGB floats, uncompressed, and some more
_HEADED = ("PNG", "JPEG", "BMP", "WEBP", "PPM", "JPEG2000")  # Pillow's names
_TIFF = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
_DAMAGED = "damaged or not an image"


def read_image(path: Path, flags: int = cv2.IMREAD_UNCHANGED) -> np.ndarray:
    """The image in a file, in OpenCV's order of channels.

    Raises:
        InputError: as `decoded_image`; not a regular file, or too large.
        OSError: the file cannot be read.
    """
    return decoded_image(read_data(path, most_bytes=_MOST_BYTES), flags)


def decoded_image(data: bytes, flags: int = cv2.IMREAD_UNCHANGED) -> np.ndarray:
    """The image in the bytes of a file, in OpenCV's order of channels.

    Raises:
        InputError: empty, truncated, damaged, no image, or of too many pixels.
    """
    if not data:
        raise InputError("is empty")
    if _is_cut_short(data):
        raise InputError("is truncated")
    check_pixels(*_size_in(data))
    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), flags)
    except cv2.error as error:
        raise InputError(f"is {_DAMAGED}") from error
    if image is None:
        raise InputError(f"is {_DAMAGED}")
    return image


def check_pixels(width: float, height: float) -> None:
    """Refuse an image before memory is taken for it.

    Raises:
        InputError: more than `MOST_PIXELS`.
    """
    if width * height > MOST_PIXELS:
        raise InputError(
            f"has {width:.0f} x {height:.0f} pixels; at most {MOST_PIXELS:,} are read. Cut it, or "
            "save it smaller"
        )


def _size_in(data: bytes) -> tuple[int, int]:
    """Width and height that the header announces, px."""
    if data.startswith(_TIFF):
        return _tiff_size(data)
    from PIL import Image, UnidentifiedImageError

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # about sizes; ours is the smaller limit
            with Image.open(io.BytesIO(data), formats=_HEADED) as image:
                return image.size
    except Image.DecompressionBombError as error:
        raise InputError(
            f"has more than {MOST_PIXELS:,} pixels; no more are read. Cut it, or save it smaller"
        ) from error
    except (UnidentifiedImageError, OSError, ValueError, SyntaxError, OverflowError) as error:
        raise InputError(f"is {_DAMAGED}") from error


def _tiff_size(data: bytes) -> tuple[int, int]:
    import tifffile

    with damage_reported("header", "Save it again"):
        with tifffile.TiffFile(io.BytesIO(data)) as file:
            page = file.pages.first
            return page.imagewidth, page.imagelength


def _is_cut_short(data: bytes) -> bool:
    """Whether a PNG or JPEG lacks its end, which decoders fill with grey."""
    if data.startswith(b"\x89PNG"):
        return b"IEND" not in data
    if data.startswith(b"\xff\xd8"):
        return data.rfind(b"\xff\xd9") < data.rfind(b"\xff\xda")  # end of image, start of scan
    return False
