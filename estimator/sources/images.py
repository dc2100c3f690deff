"""Image files as sources: a folder of them, one of them, the pages of a TIFF."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

from estimator.files import (
    damage_reported,
    image_of_page,
    in_utf8,
    opened_tiff,
    pages_of_frames,
    read_image,
)
from estimator.sources.source import AGAIN, Frame, Source, note_of_turn
from optics import InputError

TIFF = (".tif", ".tiff", ".btf", ".tf8", ".lsm", ".stk")
IMAGES = (".png", ".jpg", ".jpeg", ".bmp", ".webp", ".pgm", ".ppm", ".pbm", ".pnm", ".jp2", *TIFF)


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
            name = in_utf8(path.relative_to(folder))
            with damage_reported(f"{path} (frame {index})", AGAIN):
                found = read_image(path)
            yield Frame(
                index=index,
                file_name=name,
                time_s=math.nan,
                image=found.image,
                full_scale=found.full_scale,
            )

    name = pictures[0] if len(pictures) == 1 else folder
    notes: tuple[str, ...] = ()
    with suppress(InputError, OSError):  # damage is reported when the frame is read
        if read_image(pictures[0]).orientation != 1:
            notes = (note_of_turn(pictures[0].name),)
    return Source(name=str(name), read=read, length=len(pictures), notes=notes)


def open_tiff(path: Path) -> Source:
    """The pages of a TIFF.

    Raises:
        InputError: it cannot be read, or as `pages_of_frames`.
    """
    with damage_reported(f"{path}", AGAIN), opened_tiff(path) as file:
        numbers, whole = pages_of_frames(file)
        turned = file.pages[numbers[0]].aspage().tags.valueof("Orientation", 1) != 1

    def read() -> Iterator[Frame]:
        with opened_tiff(path) as file:
            for index, number in enumerate(numbers):
                with damage_reported(f"{path}, frame {index}", AGAIN):
                    found = image_of_page(file.pages[number].aspage())
                yield Frame(
                    index=index,
                    file_name=f"{in_utf8(path.name)}#{number}",
                    time_s=math.nan,
                    image=found.image,
                    full_scale=found.full_scale,
                )
        if not whole:
            raise InputError(f"{path} breaks off after frame {len(numbers) - 1}. {AGAIN}")

    return Source(
        name=str(path),
        read=read,
        length=len(numbers),
        notes=(note_of_turn(path.name),) if turned else (),
    )
