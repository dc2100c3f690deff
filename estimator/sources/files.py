"""Images and videos as sources of frames."""

import math
import re
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from eyespot.estimator.sources.edit_list import shown_share
from eyespot.estimator.sources.source import AGAIN, Frame, Source, note_of_turn, notes_of_aspect
from eyespot.estimator.sources.times import times_of
from eyespot.formats.foreign import what_it_is
from eyespot.formats.image_files import (
    check_pixels,
    image_of_page,
    opened_tiff,
    pages_of_frames,
    pixel_aspect,
    read_image,
)
from eyespot.formats.inputs import InputError, in_utf8, shortened
from eyespot.formats.whole_files import damage_reported

TIFF = (".tif", ".tiff", ".btf", ".tf8", ".lsm", ".stk")
IMAGES = (".png", ".jpg", ".jpeg", ".bmp", ".webp", ".pgm", ".ppm", ".pbm", ".pnm", ".jp2", *TIFF)


def open_images(path: Path, *, fps: float | None = None) -> Source:
    """An image, or a folder of images in the natural order of their names.

    The times are those of frames.csv beside the images, of EXIF, or of a rate.

    Images whose names differ only in one number that counts up by a constant step, such as
    frame_000.png, frame_002.png, are a recording. All others are unrelated to each other.

    Raises:
        InputError: the folder contains no images.
    """
    if not path.is_dir():
        return listed_images([path], fps=fps)
    pictures = [
        one
        for one in path.iterdir()
        if one.suffix.lower() in IMAGES and not one.name.startswith(".")
    ]
    if not pictures:
        raise InputError(
            f"{path} holds no images ({', '.join(IMAGES)}), and is neither a stack (stack.toml)"
            f" nor a ROS 2 bag (metadata.yaml). {_others(path) or 'Check the path.'}"
        )
    pictures.sort(key=lambda one: (_natural(one.name), one.name))
    source = listed_images(pictures, fps=fps)
    # Images whose times are known are a sequence, however they are named.
    return replace(source, unrelated=not (source.rate_hz or _is_counted(pictures)))


def _others(folder: Path) -> str:
    """What the first file of a folder is, if it is of a kind that is not read."""
    files = (path for path in sorted(folder.iterdir()) if path.is_file())
    told = ((path.name, what_it_is(path)) for path in files)
    return next((f"{name} is {what}." for name, what in told if what), "")


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


def listed_images(pictures: Sequence[Path], *, fps: float | None = None) -> Source:
    """Images in the given order, of one folder or of several.

    Raises:
        InputError: as `times_of`.
    """
    times = times_of(pictures, fps=fps)

    def read() -> Iterator[Frame]:
        for index, path in enumerate(pictures):
            about: dict[str, Any] = {
                "index": index,
                "file_name": in_utf8(path.name),
                "time_s": float(times.time_s[index]),
                "exposure_s": float(times.exposure_s[index]),
            }
            try:
                with damage_reported(f"{path} (frame {index})", AGAIN):
                    found = read_image(path)
            except InputError as error:
                yield Frame(fault=f"{error}", **about)
                continue
            yield Frame(image=found.image, full_scale=found.full_scale, **about)

    name = pictures[0] if len(pictures) == 1 else pictures[0].parent
    notes: tuple[str, ...] = ()
    with suppress(InputError, OSError):  # damage is reported when the frame is read
        if read_image(pictures[0]).orientation != 1:
            notes = (note_of_turn(pictures[0].name),)
        notes += notes_of_aspect(pictures[0].name, pixel_aspect(pictures[0]))
    return Source(
        name=str(name),
        read=read,
        length=len(pictures),
        rate_hz=rate_of(times.time_s),
        notes=notes,
        gapless=True,
    )


def rate_of(times_s: np.ndarray) -> float | None:
    """Frames a second, by the median step; None where the times do not say."""
    step = float(np.median(np.diff(times_s))) if times_s.size > 1 else math.nan
    return 1 / step if step > 0 else None


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
                    image=found.image,
                    full_scale=found.full_scale,
                )
        if not whole:
            raise InputError(f"{path} breaks off after frame {len(numbers) - 1}. {AGAIN}")

    return Source(
        name=str(path),
        read=read,
        length=len(numbers),
        notes=(
            *((note_of_turn(path.name),) if turned else ()),
            *notes_of_aspect(path.name, pixel_aspect(path)),
        ),
    )


_MOST_DIGITS = 4  # digits of a camera's number; video4linux counts to 63
_MOST_FRAMES = 2**31
_SIDES = (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT)


@contextmanager
def _capturing(what: Path | int, refusal: str) -> Iterator[cv2.VideoCapture]:
    with ExitStack() as files:
        name = what if isinstance(what, int) else str(what)
        if isinstance(what, Path) and in_utf8(what) != name:
            # OpenCV would end the process at a name that is not UTF-8.
            name = f"/proc/self/fd/{files.enter_context(what.open('rb')).fileno()}"
        capture = cv2.VideoCapture(name)
        files.callback(capture.release)
        if not capture.isOpened():
            raise InputError(refusal)
        capture.set(cv2.CAP_PROP_ORIENTATION_AUTO, 0)  # frames as the sensor saw them
        yield capture


def _captured(what: Path | int, refusal: str) -> Iterator[tuple[np.ndarray, float]]:
    """The images, and the time of each by its container, ms."""
    with _capturing(what, refusal) as capture:
        while True:
            seen, image = capture.read()
            if not seen:
                return
            rgb = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2RGB)
            yield rgb, capture.get(cv2.CAP_PROP_POS_MSEC)


def open_video(path: Path) -> Source:
    """A video file.

    Raises:
        InputError: it cannot be read.
    """
    refusal = f"{path} is not a video that OpenCV can read, or it is truncated. {AGAIN}"
    with _capturing(path, refusal) as capture:
        announced = capture.get(cv2.CAP_PROP_FRAME_COUNT)
        rate_hz = capture.get(cv2.CAP_PROP_FPS)
        turned = capture.get(cv2.CAP_PROP_ORIENTATION_META)
        wide, high = (capture.get(p) for p in (cv2.CAP_PROP_SAR_NUM, cv2.CAP_PROP_SAR_DEN))
        with damage_reported(f"{path}", AGAIN):
            check_pixels(*(capture.get(side) for side in _SIDES))
    length = round(announced * shown_share(path)) if 0 < announced < _MOST_FRAMES else None
    rate = rate_hz if 0 < rate_hz < math.inf else None

    def read() -> Iterator[Frame]:
        number, time_s = 0, 0.0
        for number, (image, time_ms) in enumerate(_captured(path, refusal), 1):
            time_s, name = round(time_ms / 1e3, 9), f"{in_utf8(path.name)}#{number - 1}"
            yield Frame(index=number - 1, file_name=name, time_s=time_s, image=image)
        # Some containers state only a duration, and the frame rate may vary: a video is truncated
        # if both its frames and its time are fewer than announced.
        if length and rate and number < length and time_s * rate < length - 2:
            raise InputError(
                f"{path} breaks off at frame {number} of the {length} that it announces. {AGAIN}"
            )

    notes: tuple[str, ...] = (note_of_turn(path.name),) if turned else ()
    notes += notes_of_aspect(path.name, wide / high if wide > 0 and high > 0 else 1.0)
    return Source(name=str(path), read=read, length=length, rate_hz=rate, notes=notes)


def open_camera(digits: str) -> Source:
    """A camera; the time of a frame is that of its arrival, s since 1970.

    Raises:
        InputError: it cannot be opened.
    """
    if len(digits) > _MOST_DIGITS:
        raise InputError(
            f"camera {shortened(digits)}: a camera's number has at most {_MOST_DIGITS} digits, and "
            "no file has this name. Check the path or the number (ls /dev/video*)."
        )
    number = int(digits)
    refusal = (
        f"camera {number} cannot be opened (and no file is named {number}). Check that it is"
        " plugged in, that no other program uses it, and its number (ls /dev/video*)."
    )
    with _capturing(number, refusal) as capture:
        rate_hz = capture.get(cv2.CAP_PROP_FPS)

    def read() -> Iterator[Frame]:
        count = 0
        for count, (image, _) in enumerate(_captured(number, refusal), 1):
            yield Frame(index=count - 1, time_s=time.time(), image=image)
        raise InputError(f"camera {number} stopped at frame {count}. Check its cable.")

    rate = rate_hz if 0 < rate_hz < math.inf else None
    return Source(name=f"camera {number}", read=read, rate_hz=rate, live=True)
