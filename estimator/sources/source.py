"""A source of frames of any kind; `open_source` makes one.

A source is read frame by frame. Damage ends it with one ValueError that names the file, the frame
and the remedy, after the frames before it have been returned.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from eyespot.formats.inputs import InputError
from eyespot.formats.rig import Rig
from eyespot.formats.stack import FrameLabels

AGAIN = "Record, copy or convert it again."
"""What to do about a damaged recording."""


def note_of_turn(name: object) -> str:
    """What to say of a file that is to be shown turned or mirrored."""
    return (
        f"{name} asks viewers to turn or mirror its frames. They are measured as they are stored,"
        " as the sensor saw them."
    )


_SQUARE = 0.01
"""How far the aspect of a square pixel is from 1 as files round it."""


def notes_of_aspect(name: object, aspect: float) -> tuple[str, ...]:
    """What to say of a file whose pixels are not square; nothing of others."""
    if abs(aspect - 1) < _SQUARE:
        return ()
    return (
        f"{name} says that its pixels are {aspect:.3f} times as wide as high. They are measured as"
        " squares; resample the images, or calibrate the microscope with them.",
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class Frame:
    """One image of a source.

    Attributes:
        index: number of the frame in its source, from 0.
        file_name: of the image, relative to its source; FILE#N for a page or a frame of a video;
            empty where frames are no files.
        time_s: when it was taken, on the source's clock; NaN if unknown.
        image: (H, W) or RGB (H, W, 3); uint8, uint16, float32 or float64.
        exposure_s: NaN if unknown.
        full_scale: value at which the source's samples end, where it says so; None otherwise.
        fault: why it could not be decoded, and is black or has no pixels; empty if it could.
    """

    index: int
    image: np.ndarray = field(default_factory=lambda: np.empty((0, 0), np.uint8))
    file_name: str = ""
    time_s: float = math.nan
    exposure_s: float = math.nan
    full_scale: float | None = None
    fault: str = ""


@dataclass(frozen=True, kw_only=True)
class Source:
    """Frames in order; iterating opens the file or the camera and reads them one by one.

    Attributes:
        length: number of frames; None for a camera. Of a video it is what its container says.
        live: whether it is a camera, which ends only when it is stopped.
        rig: that made a stack; None where the source does not contain it.
        poses_file: of a source that contains the robot's poses; None otherwise.
        labels: of a stack's frames; empty where nobody knows the truth.
        unrelated: frames that are measured one by one, because a spot cannot be followed from one
            to the next.
        gapless: whether a frame that cannot be decoded ends it, unless its frames are unrelated.
        notes: what a user should know of the file, though it is no error.
    """

    name: str
    read: Callable[[], Iterator[Frame]]
    length: int | None = None
    rate_hz: float | None = None
    live: bool = False
    rig: Rig | None = None
    poses_file: Path | None = None
    labels: tuple[FrameLabels, ...] = ()
    unrelated: bool = False
    gapless: bool = False
    notes: tuple[str, ...] = ()

    def __iter__(self) -> Iterator[Frame]:
        """Read the frames.

        Raises:
            InputError: a frame is damaged, or not of the first one's size in a sequence.
        """
        first = None
        for frame in self.read():
            if frame.fault and self.gapless and not self.unrelated:
                raise InputError(frame.fault)
            first = first or frame
            sizes = [f"{one.image.shape[1]}x{one.image.shape[0]} px" for one in (first, frame)]
            if sizes[0] != sizes[1] and not (self.unrelated or first.fault or frame.fault):
                names = [one.file_name or f"frame {one.index}" for one in (first, frame)]
                raise InputError(
                    f"{self.name}: {names[1]} has {sizes[1]}, but {names[0]} {sizes[0]}. Leave the"
                    " others out, or measure every image by itself (`eyespot track --unrelated`)."
                )
            yield frame
