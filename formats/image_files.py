"""Image files that anyone may have written, TIFF's dialects included, read within a limit.

The tags are those of TIFF 6.0 (Adobe 1992), the pattern of a raw mosaic that of TIFF/EP (ISO
12234-2).
"""

from __future__ import annotations

import io
import logging
import math
import re
import warnings
from pathlib import Path
from typing import IO, TYPE_CHECKING, NamedTuple

import cv2
import numpy as np

from eyespot.formats.foreign import LFS_POINTER
from eyespot.formats.inputs import InputError, read_data

if TYPE_CHECKING:
    from tifffile import TiffFile, TiffFrame, TiffPage


MOST_PIXELS = 2**26
"""Most pixels of an image: 8192 x 8192, the largest that a scene file can ask for."""


class DecodedImage(NamedTuple):
    """An image as a file contains it.

    Attributes:
        image: (H, W) or RGB (H, W, 3); uint8, uint16, float32 or float64.
        full_scale: value at which the samples end, if the file states fewer bits than its samples
            have room for; None otherwise.
        orientation: 1, or the number of the Exif orientation in which the file is to be shown. The
            image itself is as it is stored.
    """

    image: np.ndarray
    full_scale: float | None = None
    orientation: int = 1


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


def over_black(image: np.ndarray, alpha: np.ndarray, opaque: float) -> np.ndarray:
    """An image over black: what lies under alpha 0 is not in it.

    An alpha that is the same everywhere says nothing about the image, and changes nothing.

    Raises:
        InputError: it is transparent everywhere.
    """
    if not alpha.any():
        raise InputError("is transparent everywhere (alpha 0)")
    if alpha.min() == alpha.max():
        return image
    seen = image * (alpha / opaque).reshape(alpha.shape + (1,) * (image.ndim - 2))
    return (seen if image.dtype.kind == "f" else np.rint(seen)).astype(image.dtype)


_COLOURS = {"MINISWHITE": 1, "MINISBLACK": 1, "PALETTE": 1, "CFA": 1} | {"RGB": 3, "SEPARATED": 4}
"""Photometric interpretations that are read, and their samples a pixel without alpha."""
_MOSAICS = {
    (0, 1, 1, 2): cv2.COLOR_BayerRGGB2RGB,
    (2, 1, 1, 0): cv2.COLOR_BayerBGGR2RGB,
    (1, 0, 2, 1): cv2.COLOR_BayerGRBG2RGB,
    (1, 2, 0, 1): cv2.COLOR_BayerGBRG2RGB,
}
"""By the tag CFAPattern: 0 is red, 1 green, 2 blue."""
_JPEG = 7


def opened_tiff(file: Path | IO[bytes]) -> TiffFile:
    """An open TIFF; errors of the file are raised, and not logged as well."""
    import tifffile

    logging.getLogger("tifffile").setLevel(logging.CRITICAL)
    return tifffile.TiffFile(file)


def pages_of_frames(file: TiffFile) -> tuple[list[int], bool]:
    """Numbers of the pages that are frames, in the order of time, and whether the file is whole.

    Thumbnails, masks and reduced copies are no frames. Of OME, ImageJ and other files that name
    their axes, one may be long beside those of an image: time, or depth, as which many programs
    write time.

    Raises:
        InputError: no such page, several series, more axes or others, or several images in a page.
    """
    if not len(file.pages):
        raise InputError("is damaged in its first page")
    end = file.pages.next_page_offset
    file.filehandle.seek(end or 0)
    whole = end is not None and not any(file.filehandle.read(file.tiff.offsetsize))
    # Our own OME-TIFF has the masks of its frames as a second series.
    series = [one for one in file.series if not _is_aside(one.keyframe) and one.name != "mask"]
    named_axes = bool(series) and series[0].kind != "generic"
    if len(series) > 1 and named_axes and series[0].kind != "shaped":
        raise InputError(f"holds {len(series)} series of images. Save one of them alone")
    numbers = []
    for one in series:
        long = [
            (axis, size)
            for axis, size in zip(one.axes, one.shape, strict=True)
            if size > 1 and axis not in one.keyframe.axes
        ]
        images = math.prod(size for _, size in long)
        if whole and images > len(one.pages):
            raise InputError(
                f"holds {images} images in {len(one.pages)} pages, as ImageJ writes files above 4"
                " GB, and MetaMorph its stacks. Save it as a BigTIFF or as a folder of images"
            )
        if len(long) > 1 or any(axis not in "TZIQ" for axis, _ in long):
            named = ", ".join(f"{axis} = {size}" for axis, size in long)
            raise InputError(
                f"has the axes {named} beside those of an image; frames lie along one, T (time) or"
                " Z (depth). Save one channel, depth or series alone"
            )
        numbers += [page.index for page in one.pages if page is not None and page.parent is file]
    if not named_axes:
        # tifffile sorts pages by their size and kind, and adds those of SubIFDs.
        numbers = [page.index for page in file.pages if not _is_aside(page.aspage())]
    if not numbers:
        raise InputError("has no image of full size among its pages (as camera raw files)")
    return numbers, whole


def _is_aside(page: TiffPage | TiffFrame) -> bool:
    """Whether it is a reduced copy, a thumbnail or a mask of another page."""
    page = page.aspage()
    return bool(page.subfiletype & 5 or page.tags.valueof("SubfileType") == 2)


def image_of_page(page: TiffPage) -> DecodedImage:
    """The image of a page.

    Raises:
        InputError: of a kind that is not read, or too many pixels.
        Exception: any error of a decoder, of a damaged page.
    """
    check_pixels(page.imagewidth, page.imagelength * page.imagedepth * page.samplesperpixel / 4)
    kind = getattr(page.photometric, "name", f"photometric interpretation {page.photometric}")
    # tifffile decodes a JPEG as RGB, except its separate planes.
    as_rgb = page.compression == _JPEG and page.planarconfig == 1 and not page.extrasamples
    colours = 3 if kind == "YCBCR" and as_rgb else _COLOURS.get(kind, 0)
    spare = page.samplesperpixel - colours
    if (
        not colours
        or spare not in (0, 1)
        or page.imagedepth > 1
        or not isinstance(page.bitspersample, int)
        or (kind == "SEPARATED" and page.tags.valueof("InkSet", 1) != 1)
    ):
        raise InputError(
            f"has {page.samplesperpixel} samples a pixel of {page.bitspersample} bits as {kind};"
            " grey, palettes, RGB, CMYK, YCbCr in JPEG and Bayer mosaics are read, and alpha beside"
            " them"
        )
    samples = page.asarray()
    if "S" in page.axes:
        samples = np.moveaxis(samples, page.axes.index("S"), 2)
    samples, full_scale = _samples(samples, page)
    image = (
        samples[..., :colours] if colours > 1 else samples.reshape(*samples.shape[:2], -1)[..., 0]
    )
    most = full_scale or (np.iinfo(image.dtype).max if image.dtype.kind == "u" else math.nan)
    if kind in ("MINISWHITE", "SEPARATED") and math.isnan(most):
        raise InputError(f"has floats or negative values as {kind}, whose full scale is unknown")
    if kind == "MINISWHITE":
        image = np.asarray(most - image, image.dtype)
    elif kind == "SEPARATED":
        light = most - image.astype(np.float32)
        image = np.rint(light[..., :3] * light[..., 3:] / most).astype(image.dtype)
    elif kind == "PALETTE" and page.colormap is not None:
        palette, full_scale = page.colormap, None
        if not (palette % 257).any() or not (palette % 256).any():  # 16 bits that have 8
            palette = (palette >> 8).astype(np.uint8)
        image = np.moveaxis(palette[:, image], 0, 2)
    elif kind == "CFA":
        pattern, size = map(page.tags.valueof, ("CFAPattern", "CFARepeatPatternDim"))
        code = _MOSAICS.get(tuple(pattern or ()))
        if code is None or size != (2, 2) or image.dtype.kind != "u":
            raise InputError(
                f"has a raw mosaic with the CFAPattern {pattern}; Bayer's 2 x 2 are read"
            )
        image = cv2.cvtColor(image, code)
    if spare and (1 not in page.extrasamples):  # 1: multiplied by alpha already
        alpha = samples[..., -1]
        if 2 not in page.extrasamples and alpha.min() != alpha.max():
            raise InputError(
                "has a further sample a pixel, and does not state whether it is alpha. Save it"
                " without"
            )
        image = over_black(image, alpha, 1.0 if math.isnan(most) else most)
    return DecodedImage(image, full_scale, page.tags.valueof("Orientation", 1))


def _samples(image: np.ndarray, page: TiffPage) -> tuple[np.ndarray, float | None]:
    """Samples as a frame has them, and their full scale if the file states it."""
    bits, kind = page.bitspersample, image.dtype.kind
    if kind == "b":
        return np.where(image, np.uint8(255), np.uint8(0)), None
    if kind not in "uif" or image.dtype.itemsize > 8:
        raise InputError(f"has samples of the type {image.dtype.name}; whole or real numbers are")
    if image.dtype.name == "float16":
        return image.astype(np.float32), None
    if kind == "f":
        return image.astype(image.dtype.newbyteorder("="), copy=False), None
    bits -= kind == "i"
    full_scale = 2.0**bits - 1 if bits < 8 * image.dtype.itemsize else None
    # The largest sample of the image itself, as some programs state it, is no full scale.
    stated = int(np.max(page.tags.valueof("MaxSampleValue", 0)))
    if 0 < stated < 2**bits - 1 and not stated & (stated + 1):
        full_scale = float(stated)
    if image.dtype.itemsize > 2:
        return image.astype(np.float64), full_scale if bits < 31 else None
    if kind == "i" and image.min() < 0:
        return image.astype(np.float32), full_scale
    return image.astype(f"u{image.dtype.itemsize}"), full_scale


_MOST_BYTES = 2**30  # largest file: as many pixels as RGB floats, uncompressed, and some more
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
    if data.startswith(LFS_POINTER):
        raise InputError("is a pointer of Git LFS, not the image. Fetch it: git lfs pull")
    # Decoders fill what lacks at the end with grey.
    is_cut = data.startswith(_PNG) and b"IEND" not in data
    if data.startswith(b"\xff\xd8"):  # a JPEG's end of image, and its start of the last scan
        is_cut = data.rfind(b"\xff\xd9") < data.rfind(b"\xff\xda")
    if is_cut:
        raise InputError("is truncated")
    try:
        if not data.startswith(_TIFF):
            return _image(data)
        with opened_tiff(io.BytesIO(data)) as file:
            pages, whole = pages_of_frames(file)
            if not whole:
                raise InputError("is truncated")
            if len(pages) > 1:
                raise InputError(f"holds {len(pages)} frames. Give it as a source of its own")
            return image_of_page(file.pages[pages[0]].aspage())
    except (InputError, MemoryError, ImportError):  # a missing decoder is no damaged image
        raise
    except Exception as error:  # decoders raise errors of all kinds
        raise InputError(_DAMAGED) from error


def _image(data: bytes) -> DecodedImage:
    orientation = _checked_header(data)
    if data.startswith(_PNG):
        import imagecodecs

        # OpenCV drops the transparent level of a grey image.
        image = np.asarray(imagecodecs.png_decode(_pixels_of_png(data)))
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


def _pixels_of_png(data: bytes) -> bytes:
    """A PNG without profiles, times and texts, about which libpng prints words of its own."""
    kept, at = [data[:8]], 8
    while at + 8 <= len(data):
        end = at + 12 + int.from_bytes(data[at : at + 4], "big")
        name = data[at + 4 : at + 8]
        if name == b"tRNS" or not name[0] & 0x20:  # a small first letter: not needed for the pixels
            kept.append(data[at:end])
        at = end
    return b"".join(kept)


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


def pixel_aspect(path: Path) -> float:
    """Width of a pixel over its height, as an image's file states it; 1 if it does not."""
    from PIL import Image

    try:
        with warnings.catch_warnings(action="ignore"), Image.open(path) as image:
            info = image.info
    except Exception:  # decoders raise all kinds of errors for damage
        return 1.0
    # A JPEG without a unit states the aspect alone.
    alone = info.get("jfif_density") if info.get("jfif_unit") == 0 else None
    across, down = alone or info.get("dpi") or (1, 1)
    return float(down) / float(across) if across and down else 1.0


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
