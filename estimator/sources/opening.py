"""Opens a source: a stack, images, a video, a camera or a bag."""

import itertools
import math
import os
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from eyespot.estimator.frame_window import checked_frame
from eyespot.estimator.sources.arrays import ARRAYS, open_array
from eyespot.estimator.sources.dicom import is_dicom, open_dicom
from eyespot.estimator.sources.files import (
    IMAGES,
    TIFF,
    open_camera,
    open_images,
    open_tiff,
    open_video,
    rate_of,
)
from eyespot.estimator.sources.genicam import GENICAM, open_genicam
from eyespot.estimator.sources.ros import open_bag
from eyespot.estimator.sources.source import Frame, Source
from eyespot.formats.foreign import what_it_is
from eyespot.formats.inputs import InputError, shortened
from eyespot.formats.rig import rig_of_stack
from eyespot.formats.ros_bags import is_bag
from eyespot.formats.stack import read_stack

_USUAL = "metered"


def open_source(
    source: str | Path,
    *,
    exposure: str | None = None,
    image_topic: str | None = None,
    fps: float | None = None,
) -> Source:
    """Open a source of frames.

    Args:
        source: a stack folder, a folder of images (in natural order of their names), an image, a
            multi-page TIFF, a DICOM file, an array, a video, a ROS 1 or ROS 2 bag, the number of a
            camera, or genicam: and the number or name of a GenICam camera.
        exposure: of a stack that has several; by default "metered", whose peaks are never
            saturated.
        image_topic: of a bag, see `open_bag`.
        fps: images a second of a folder, a TIFF or an array without times; None: unknown.

    Raises:
        InputError: the source does not exist, cannot be read or is empty, or it has no such
            exposure or topic. Reading the frames raises it for damage that is found later.
    """
    path = Path(source)
    if str(source).startswith(GENICAM):
        opened = open_genicam(str(source).removeprefix(GENICAM))
    elif not path.exists():
        if str(source).isdecimal():
            opened = open_camera(str(source))
        else:
            raise InputError(
                f"{shortened(str(path))}: there is no such file or folder. Check the path."
            )
    elif not os.access(path, os.R_OK):
        raise InputError(f"{path} may not be read. Change its permissions.")
    elif (path / "stack.toml").is_file():
        return _stack(path, exposure)
    elif is_bag(path):
        opened = open_bag(path, topic=image_topic)
    elif path.is_dir():
        opened = open_images(path, fps=fps)
    elif not path.is_file():
        raise InputError(
            f"{path} is a pipe, device or socket, which may never end. Give a file, a folder, or "
            "the number of a camera."
        )
    elif told := what_it_is(path):
        raise InputError(f"{path} is {told}.")
    elif is_dicom(path):
        opened = open_dicom(path)
    elif path.suffix.lower() in ARRAYS:
        opened = open_array(path)
    elif path.suffix.lower() in TIFF:
        opened = open_tiff(path)
    elif path.suffix.lower() in IMAGES:
        opened = open_images(path)
    else:
        opened = open_video(path)
    if exposure is not None:
        raise InputError(f"{source} is not a stack, so it has no exposures. Leave the option out.")
    if fps is None or path.is_dir():
        return opened
    if opened.live or any(math.isfinite(frame.time_s) for frame in itertools.islice(opened, 1)):
        raise InputError(f"{source} has its own times. Leave --fps out.")
    return _at_rate(opened, fps)


def _at_rate(source: Source, fps: float) -> Source:
    """A source without times, such as a TIFF's pages, at a constant rate."""

    def read() -> Iterator[Frame]:
        for frame in source:
            yield replace(frame, time_s=frame.index / fps)

    return replace(source, read=read, rate_hz=fps)


def array_source(
    frames: np.ndarray | Sequence[np.ndarray],
    *,
    times_s: Sequence[float] | np.ndarray | None = None,
    exposure_s: Sequence[float] | np.ndarray | float | None = None,
    name: str = "frames",
) -> Source:
    """Frames in memory.

    Args:
        frames: frames x h x w, or frames x h x w x 3 (RGB), as `checked_frame` takes each.
        times_s: of the middles of their exposures, s; None: unknown.
        exposure_s: exposure times, or the one of all frames, s; None: unknown.

    Raises:
        InputError: no frames, or another number of times than of frames.
    """
    count = len(frames)
    if count == 0 or np.ndim(frames[0]) < 2:
        raise InputError(
            f"{name} must be frames x height x width, or with 3 colours behind it; got shape "
            f"{np.shape(frames)}. A single image is array[None]."
        )
    unknown = np.full(count, np.nan)
    times = unknown if times_s is None else np.asarray(times_s, float)
    exposures = unknown if exposure_s is None else np.broadcast_to(exposure_s, count).astype(float)
    if times.shape != (count,):
        raise InputError(f"{name} has {count} frames, but {times.size} times. Give one for each.")

    def read() -> Iterator[Frame]:
        for index, image in enumerate(frames):
            yield Frame(
                index=index,
                image=checked_frame(np.asarray(image)),
                time_s=float(times[index]),
                exposure_s=float(exposures[index]),
            )

    return Source(name=name, read=read, length=count, rate_hz=rate_of(times))


def _stack(folder: Path, exposure: str | None) -> Source:
    stack = read_stack(folder)
    kinds = sorted({labels.exposure for labels in stack.labels})
    if not kinds:
        raise InputError(f"{folder} holds no frames. Render the stack again.")
    kind = exposure or (_USUAL if _USUAL in kinds else kinds[0])
    chosen, others = stack.exposed(kind), " and ".join(k for k in kinds if k != kind)
    if not chosen:
        raise InputError(f"{folder} holds no exposure {exposure}. Choose {' or '.join(kinds)}.")

    def read() -> Iterator[Frame]:
        for labels in chosen:
            yield Frame(
                index=labels.frame,
                file_name=labels.file_name,
                time_s=labels.time_s,
                image=checked_frame(stack.image(labels)),
                exposure_s=labels.exposure_s,
            )

    return Source(
        name=str(folder),
        read=read,
        length=len(chosen),
        rate_hz=rate_of(np.array([labels.time_s for labels in chosen])),
        rig=rig_of_stack(folder, stack.description, medium=chosen[0].medium),
        poses_file=folder / "kinematics.csv",
        labels=chosen,
        notes=()
        if exposure or not others
        else (f"Reading the exposure {kind} (the stack also has {others}); --exposure chooses.",),
    )
