"""Videos and cameras as sources, both through OpenCV."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import cv2
import numpy as np

from estimator.files import check_pixels, damage_reported, in_utf8
from estimator.sources.source import AGAIN, Frame, Source, note_of_turn
from optics import InputError, shortened

_MOST_DIGITS = 4  # of a camera's number; video4linux counts to 63
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
        with damage_reported(f"{path}", AGAIN):
            check_pixels(*(capture.get(side) for side in _SIDES))
    length = int(announced) if 0 < announced < _MOST_FRAMES else None
    rate = rate_hz if 0 < rate_hz < math.inf else None

    def read() -> Iterator[Frame]:
        index, time_s = 0, 0.0
        with _capturing(path, refusal) as capture:
            while True:
                seen, image = capture.read()
                if not seen:
                    break
                time_s = round(capture.get(cv2.CAP_PROP_POS_MSEC) / 1e3, 9)
                name = f"{in_utf8(path.name)}#{index}"
                yield Frame(index=index, file_name=name, time_s=time_s, image=_rgb(image))
                index += 1
        # Some containers state only a duration, and the frame rate may vary: a video is truncated
        # if both its frames and its time are fewer than announced.
        if length and rate and index < length and time_s * rate < length - 2:
            raise InputError(
                f"{path} breaks off at frame {index} of the {length} that it announces. {AGAIN}"
            )

    notes = (note_of_turn(path.name),) if turned else ()
    return Source(name=str(path), read=read, length=length, rate_hz=rate, notes=notes)


def _rgb(image: np.ndarray) -> np.ndarray:
    return image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2RGB)


def open_camera(digits: str) -> Source:
    """A camera; the time of a frame is that of its arrival, s since 1970.

    Args:
        digits: its number.

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
        index = 0
        with _capturing(number, refusal) as capture:
            while True:
                seen, image = capture.read()
                if not seen:
                    raise InputError(f"camera {number} stopped at frame {index}. Check its cable.")
                yield Frame(index=index, file_name="", time_s=time.time(), image=_rgb(image))
                index += 1

    rate = rate_hz if 0 < rate_hz < math.inf else None
    return Source(name=f"camera {number}", read=read, rate_hz=rate, live=True)
