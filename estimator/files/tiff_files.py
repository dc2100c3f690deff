"""TIFF files in the dialects of cameras and microscopes: which pages are frames, and their images.

The tags are those of TIFF 6.0 (Adobe 1992), the pattern of a raw mosaic that of TIFF/EP (ISO
12234-2).
"""

from __future__ import annotations

import logging
import math
from pathlib import Path
from typing import IO, TYPE_CHECKING

import cv2
import numpy as np

from estimator.files.decoded import DecodedImage, check_pixels, over_black
from optics import InputError

if TYPE_CHECKING:
    from tifffile import TiffFile, TiffFrame, TiffPage

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
    series = [one for one in file.series if not _is_aside(one.keyframe)]
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
        image, full_scale = _coloured(image, page.colormap), None
    elif kind == "CFA":
        image = _demosaiced(image, page)
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


def _coloured(image: np.ndarray, palette: np.ndarray) -> np.ndarray:
    """Indices as colours; of 8 bits where the palette's 16 have no more."""
    if not (palette % 257).any() or not (palette % 256).any():
        palette = (palette >> 8).astype(np.uint8)
    return np.moveaxis(palette[:, image], 0, 2)


def _demosaiced(image: np.ndarray, page: TiffPage) -> np.ndarray:
    pattern, size = map(page.tags.valueof, ("CFAPattern", "CFARepeatPatternDim"))
    code = _MOSAICS.get(tuple(pattern or ()))
    if code is None or size != (2, 2) or image.dtype.kind != "u":
        raise InputError(f"has a raw mosaic with the CFAPattern {pattern}; Bayer's 2 x 2 are read")
    return cv2.cvtColor(image, code)
