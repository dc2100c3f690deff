"""Draws the measured spots over the frames: a video, or a folder of PNGs."""

import errno
import math
import os
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import cv2
import numpy as np

from eyespot.estimator.image import outline_px, rgb_8bit
from eyespot.estimator.sources.source import Frame
from eyespot.formats.camera_sheet import LensDistortion, Response
from eyespot.formats.inputs import InputError
from eyespot.formats.spot import NoSpot
from eyespot.formats.spots import SpotRecord
from eyespot.formats.whole_files import errors_named, written_whole

RIG_RATE_HZ = 10.0
"""Frame rate of the rig's camera, and of a source whose rate is unknown."""

_CODECS = {".mp4": "mp4v", ".avi": "MJPG"}
_VIDEO_RESERVE_BYTES = 2**23  # more than what OpenCV and FFmpeg buffer of a compressed video
_FRACTION_BITS = 4  # cv2 takes fractions of a pixel as integers of 1/16 px
_GREEN, _RED, _BLACK = (60, 255, 60), (255, 70, 70), (0, 0, 0)

Draw = Callable[[Frame, SpotRecord], None]


def annotated(
    frame: Frame, record: SpotRecord, *, response: Response, camera: LensDistortion | None = None
) -> np.ndarray:
    """The frame as 8-bit RGB with the ellipse, the frame's number, and the distance or the reason.

    Args:
        camera: whose distortion was removed from the spot; it is applied again for the drawing.
    """
    picture = rgb_8bit(frame.image, response)
    lines = [f"frame {record.frame}"]
    if not math.isnan(record.time_s):
        lines[0] += f"   {record.time_s:.3f} s"
    colour = _GREEN
    if isinstance(record.result, NoSpot):
        lines.append(record.reason.replace("_", " "))
        colour = _RED
    else:
        points, centre = outline_px(record.result.ellipse, camera)
        fixed = np.rint(points * 2**_FRACTION_BITS).astype(np.int32)
        cv2.polylines(picture, [fixed], True, _GREEN, 1, cv2.LINE_AA, _FRACTION_BITS)
        x, y = np.rint(centre).astype(int).tolist()
        cv2.drawMarker(picture, (x, y), _GREEN, cv2.MARKER_CROSS, 9, 1, cv2.LINE_AA)
    if not math.isnan(record.distance_mm):  # the mode pixels may know it without a spot
        lines.append(f"d = {record.distance_mm:.3f} +- {record.sigma_distance_mm:.3f} mm")
    scale = max(picture.shape[0] / 900, 0.3)
    for number, line in enumerate(lines, 1):
        at = round(16 * scale), round(32 * scale * number)
        for ink, width in ((_BLACK, 3), (colour, 1)):  # outlined, to be readable
            cv2.putText(picture, line, at, cv2.FONT_HERSHEY_SIMPLEX, scale, ink, width, cv2.LINE_AA)
    return picture


@contextmanager
def overlay_writer(
    path: Path, *, rate_hz: float, response: Response, camera: LensDistortion | None = None
) -> Iterator[Draw]:
    """Make an overlay; it gets its name when the block ends, whole or not at all.

    Args:
        path: a video (`.mp4`, `.avi`), or a folder of PNGs where the name has no suffix.

    Yields:
        A function that adds a frame and its record; raises InputError where the frame's size is
        not the video's, and OSError where nothing can be written. The frames before it are kept.

    Raises:
        InputError: another suffix, or something of this name exists.
        OSError: the video lacks frames when the block ends.
    """
    check_overlay_path(path)
    kind = _video if path.suffix else _folder
    with written_whole(path) as partial, kind(partial, rate_hz) as write:

        def draw(frame: Frame, record: SpotRecord) -> None:
            with errors_named(partial, path):
                write(annotated(frame, record, response=response, camera=camera))

        yield draw


def check_overlay_path(path: Path) -> None:
    """Raise an InputError unless a path names a folder or a supported kind of video."""
    if path.suffix.lower() not in (*_CODECS, ""):
        raise InputError(
            f"{path}: an overlay is a video ({', '.join(_CODECS)}) or a folder, whose name has no"
            f" suffix; got {path.suffix!r}."
        )


@contextmanager
def _video(path: Path, rate_hz: float) -> Iterator[Callable[[np.ndarray], None]]:
    writer = cv2.VideoWriter()
    size: tuple[int, int] | None = None
    written = 0

    def write(picture: np.ndarray) -> None:
        nonlocal size, written
        this = picture.shape[1], picture.shape[0]
        if size is None:
            size = this
            codec = cv2.VideoWriter.fourcc(*_CODECS[path.suffix.lower()])
            if not writer.open(str(path), codec, rate_hz, size):
                raise OSError(f"{path} cannot be written as a video. Choose a folder of PNGs.")
        if this != size:
            raise InputError(
                f"a video's frames must have one size; got {this} px after {size} px. Choose a"
                " folder for the overlay."
            )
        # OpenCV does not say when it cannot write. What it has buffered still fits, and the index.
        if shutil.disk_usage(path.parent).free < _VIDEO_RESERVE_BYTES + 100 * written:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), f"{path}")
        writer.write(cv2.cvtColor(picture, cv2.COLOR_RGB2BGR))
        written += 1

    try:
        yield write
    finally:
        writer.release()
    # The number in its header is no evidence: an AVI has it even if its frames are missing. They
    # are counted without decoding them (30 us a frame).
    capture, stored = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG), 0
    capture.set(cv2.CAP_PROP_FORMAT, -1)
    while written and capture.grab():
        stored += 1
    capture.release()
    if stored < written:  # Ctrl-C may come after a frame was written and before it is counted
        why = f"only {stored} of {written} frames could be written; the disk may be full"
        raise OSError(errno.ENOSPC, why, f"{path}")


@contextmanager
def _folder(path: Path, rate_hz: float) -> Iterator[Callable[[np.ndarray], None]]:
    path.mkdir()
    written = 0

    def write(picture: np.ndarray) -> None:
        nonlocal written
        name = path / f"{written:06d}.png"
        _, content = cv2.imencode(".png", cv2.cvtColor(picture, cv2.COLOR_RGB2BGR))
        try:
            name.write_bytes(content.tobytes())
        except OSError as error:
            name.unlink(missing_ok=True)  # the part that fitted
            raise OSError(error.errno, error.strerror, f"{name}") from error
        written += 1

    yield write
