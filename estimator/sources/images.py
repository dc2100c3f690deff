"""Image files as sources: a folder of them, one of them, the pages of a TIFF."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np

from estimator.files import check_pixels, damage_reported, read_image
from estimator.image import checked_frame
from estimator.sources.source import AGAIN, Frame, Source
from optics import InputError

if TYPE_CHECKING:
    from tifffile import TiffFile

TIFF = (".tif", ".tiff")
IMAGES = (".png", ".jpg", ".jpeg", ".bmp", ".webp", ".pgm", ".ppm", ".jp2", *TIFF)


def open_folder(folder: Path) -> Source:
    """A folder of images, in the natural order of their names.

    Images whose names differ only in one number that counts up by a constant step, such as
    frame_000.png, frame_002.png, are a recording. All others are unrelated to each other.

    Raises:
        InputError: it contains no images.
    """
    pictures = [
        path
        for path in folder.iterdir()
        if path.suffix.lower() in IMAGES and not path.name.startswith(".")
    ]
    if not pictures:
        raise InputError(
            f"{folder} holds no images ({', '.join(IMAGES)}), and is neither a stack (stack.toml)"
            " nor a ROS 2 bag (metadata.yaml). Check the path."
        )
    pictures.sort(key=lambda path: (_natural(path.name), path.name))
    return replace(_images(folder, pictures), unrelated=not _is_counted(pictures))


def open_image(path: Path) -> Source:
    """A source of one frame."""
    return _images(path.parent, [path])


def _is_counted(pictures: list[Path]) -> bool:
    """Whether the names differ only in one number that counts up by a constant step."""
    rows = [_natural(path.name) for path in pictures]
    if len({len(row) for row in rows}) > 1:
        return False
    varying = [column for column in zip(*rows, strict=True) if len(set(column)) > 1]
    if len(varying) != 1 or isinstance(varying[0][0], str):
        return len(rows) == 1
    return len({after - before for before, after in pairwise(varying[0])}) == 1


def _natural(name: str) -> list[int | str]:
    """Text and numbers of a name, by which frame9 comes before frame10."""
    parts = re.split("([0-9]+)", name.lower())
    return [int(part) if index % 2 else part for index, part in enumerate(parts)]


def _images(folder: Path, pictures: list[Path]) -> Source:
    def read() -> Iterator[Frame]:
        for index, path in enumerate(pictures):
            name = path.relative_to(folder).as_posix()
            yield Frame(index=index, file_name=name, time_s=math.nan, image=_picture(path, index))

    name = pictures[0] if len(pictures) == 1 else folder
    return Source(name=str(name), read=read, length=len(pictures))


def _picture(path: Path, index: int) -> np.ndarray:
    where = f"{path} (frame {index})"
    try:
        image = read_image(path)
    except OSError as error:
        raise InputError(f"{where}: cannot be read: {error.strerror}.") from error
    except InputError as error:
        raise InputError(f"{where} {error}. {AGAIN}") from error
    with damage_reported(where, AGAIN):
        return rgb_of_opencv(image)


def rgb_of_opencv(image: np.ndarray) -> np.ndarray:
    """An image in OpenCV's order of channels as a frame, without its alpha channel.

    Raises:
        InputError: as `image.checked_frame`.
    """
    if image.ndim == 3 and image.shape[2] in (3, 4):
        order = cv2.COLOR_BGR2RGB if image.shape[2] == 3 else cv2.COLOR_BGRA2RGB
        image = cv2.cvtColor(image, order)
    return checked_frame(image)


def open_tiff(path: Path) -> Source:
    """The pages of a TIFF.

    Raises:
        InputError: it cannot be read.
    """
    import logging

    import tifffile

    # Damage is reported once, as an error from here.
    logging.getLogger("tifffile").setLevel(logging.CRITICAL)
    with damage_reported(f"{path}", AGAIN), tifffile.TiffFile(path) as file:
        length = len(file.pages)
        # ImageJ writes one directory for all images if the file exceeds 4 GB.
        announced = (file.imagej_metadata or {}).get("images", length)
        end, size = file.pages.next_page_offset, file.tiff.offsetsize
        file.filehandle.seek(end or 0)
        whole = end is not None and not any(file.filehandle.read(size))
    if whole and announced > length:
        raise InputError(
            f"{path} holds {announced} images in {length} pages, as ImageJ writes files above"
            " 4 GB. Save it as a BigTIFF or as a folder of images."
        )

    def read() -> Iterator[Frame]:
        with tifffile.TiffFile(path) as file:
            for index in range(length):
                where = f"{path}, frame {index}"
                with damage_reported(where, AGAIN):
                    image = _page(file, index)
                yield Frame(index=index, file_name="", time_s=math.nan, image=image)
        if not whole:
            raise InputError(f"{path} breaks off after frame {length - 1}. {AGAIN}")

    return Source(name=str(path), read=read, length=length)


def _page(file: TiffFile, index: int) -> np.ndarray:
    import tifffile

    page = file.pages[index].aspage()
    check_pixels(page.imagewidth, page.imagelength * page.imagedepth * page.samplesperpixel / 4)
    if page.compression not in tifffile.TIFF.DECOMPRESSORS:
        # tifffile needs a further package for LZW and JPEG. OpenCV reads every page from the first
        # on, so it is used for these only.
        seen, images = cv2.imreadmulti(file.filehandle.path, index, 1, flags=cv2.IMREAD_UNCHANGED)
        if not seen:
            raise InputError(f"page {index} cannot be decoded")
        return rgb_of_opencv(images[0])
    image = page.asarray()
    if page.axes == "SYX":
        image = np.moveaxis(image, 0, 2)
    if image.ndim == 3:
        image = np.ascontiguousarray(image[:, :, :3])  # no alpha channel
    return checked_frame(image)
