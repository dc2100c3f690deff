"""Decodes image files that anyone may have written, after a look at their size in pixels."""

from __future__ import annotations

import io
import re
import warnings
from pathlib import Path

import cv2
import numpy as np

from estimator.files.decoded import MOST_PIXELS, DecodedImage, check_pixels, over_black
from estimator.files.tiff_files import image_of_page, opened_tiff, pages_of_frames
from optics import InputError, read_data

_MOST_BYTES = 2**30  # that many pixels as RGB floats, uncompressed, and some more
_HEADED = ("PNG", "JPEG", "BMP", "WEBP", "PPM", "JPEG2000")  # Pillow's names
_TIFF = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
_PNG = b"\x89PNG"
_JP2 = (b"\0\0\0\x0cjP", b"\xff\x4f\xff\x51")
_DAMAGED = "is damaged, or not an image of a kind that is read"
_ORIENTATION = 274  # Exif's tag
_SPACE = rb"(?:\s|#[^\n]*\n)+"
_PNM = re.compile(rb"P([2356])" + _SPACE + rb"\d+" + _SPACE + rb"\d+" + _SPACE + rb"(\d+)\s")
_JPEG_2000 = re.compile(rb"\xff\x4f\xff\x51.{38}(.)", re.DOTALL)  # the bits of the first channel


def read_image(path: Path) -> DecodedImage:
    """The image in a file.

    Raises:
        InputError: as `decoded_image`; not a regular file, or too large.
        OSError: the file cannot be read.
    """
    return decoded_image(read_data(path, most_bytes=_MOST_BYTES))


def decoded_image(data: bytes) -> DecodedImage:
    """The image in the bytes of a file.

    Raises:
        InputError: empty, truncated, damaged, no image, several images, of too many pixels, or of a
            kind that is not read.
    """
    if not data:
        raise InputError("is empty")
    if _is_cut_short(data):
        raise InputError("is truncated")
    try:
        return (_tiff if data.startswith(_TIFF) else _image)(data)
    except (InputError, MemoryError):
        raise
    except Exception as error:  # decoders raise errors of all kinds
        raise InputError(_DAMAGED) from error


def _tiff(data: bytes) -> DecodedImage:
    with opened_tiff(io.BytesIO(data)) as file:
        pages, whole = pages_of_frames(file)
        if not whole:
            raise InputError("is truncated")
        if len(pages) > 1:
            raise InputError(f"holds {len(pages)} frames. Give it as a source of its own")
        return image_of_page(file.pages[pages[0]].aspage())


def _image(data: bytes) -> DecodedImage:
    orientation = _checked_header(data)
    if data.startswith(_PNG):
        import imagecodecs

        # OpenCV drops the transparent level of a grey image.
        image = np.asarray(imagecodecs.png_decode(data))
    else:
        found = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
        if found is None:
            raise InputError(_DAMAGED)
        image = np.asarray(found)
        if image.ndim == 3:
            to_rgb = cv2.COLOR_BGR2RGB if image.shape[2] == 3 else cv2.COLOR_BGRA2RGBA
            image = cv2.cvtColor(image, to_rgb)
    if image.ndim == 3 and image.shape[2] != 3:
        colours = image[:, :, 0] if image.shape[2] == 2 else image[:, :, :3]
        image = over_black(colours, image[:, :, -1], np.iinfo(image.dtype).max)
    return DecodedImage(image, _full_scale(data, image), orientation)


def _checked_header(data: bytes) -> int:
    """Refuse what its header tells; otherwise its Exif orientation."""
    from PIL import Image

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # about sizes; ours is the smaller limit
            with Image.open(io.BytesIO(data), formats=_HEADED) as image:
                size, images = image.size, getattr(image, "n_frames", 1)
                # Pillow decodes a PNG to look for it at the end.
                exif = image.getexif() if image.format != "PNG" or b"eXIf" in data else {}
    except Image.DecompressionBombError as error:
        raise InputError(
            f"has more than {MOST_PIXELS:,} pixels; no more are read. Cut it, or save it smaller"
        ) from error
    check_pixels(*size)
    if images > 1 and image.format in ("PNG", "WEBP"):
        raise InputError(f"is an animation of {images} images. Save them one by one")
    return exif.get(_ORIENTATION, 1)


def _full_scale(data: bytes, image: np.ndarray) -> float | None:
    """Value at which the samples end, if the file states fewer bits than they have room for."""
    if image.dtype.kind != "u":
        return None
    room = 8 * image.dtype.itemsize
    if found := _PNM.match(data[:4096]):
        # OpenCV scales the texts P2 and P3 to 8 bits.
        most = 255 if found[1] in b"23" and room == 8 else int(found[2])
        return float(most) if most < 2**room - 1 else None
    if found := _JPEG_2000.search(data) if data.startswith(_JP2) else None:
        bits = (found[1][0] & 127) + 1
        return 2.0**bits - 1 if bits < room else None
    at = data.find(b"sBIT", 0, data.find(b"IDAT")) if data.startswith(_PNG) else -1
    channels = data[at - 1] if at > 0 else 0
    if channels not in (1, 2, 3, 4):
        return None
    bits = max(data[at + 4 : at + (7 if channels > 2 else 5)])
    unused = room - bits
    if unused <= 0:
        return None
    # The standard has samples scaled to all bits; programs also write them at the top or as is.
    if not (image & ((1 << unused) - 1)).any():
        return float((2**bits - 1) << unused)
    return 2.0**bits - 1 if image.max() < 2**bits else None


def _is_cut_short(data: bytes) -> bool:
    """Whether a PNG or JPEG lacks its end, which decoders fill with grey."""
    if data.startswith(_PNG):
        return b"IEND" not in data
    if data.startswith(b"\xff\xd8"):
        return data.rfind(b"\xff\xd9") < data.rfind(b"\xff\xda")  # end of image, start of scan
    return False
