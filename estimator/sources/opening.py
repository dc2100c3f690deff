"""Opens a source: a stack, images, a video, a camera or a bag."""

import os
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from eyespot.estimator.sources.arrays import ARRAYS, open_array
from eyespot.estimator.sources.files import (
    IMAGES,
    TIFF,
    open_camera,
    open_images,
    open_tiff,
    open_video,
)
from eyespot.estimator.sources.genicam import GENICAM, open_genicam
from eyespot.estimator.sources.ros import open_bag
from eyespot.estimator.sources.source import Frame, Source
from eyespot.formats.camera import checked_frame
from eyespot.formats.foreign import what_it_is
from eyespot.formats.inputs import InputError, shortened
from eyespot.formats.ros_bags import is_bag
from eyespot.formats.stack import read_stack

_USUAL = "metered"


def open_source(
    source: str | Path, *, exposure: str | None = None, image_topic: str | None = None
) -> Source:
    """Open a source of frames.

    Args:
        source: a stack folder, a folder of images (in natural order of their names), an image, a
            multi-page TIFF, a video, a ROS 1 or ROS 2 bag, the number of a camera, or genicam:
            and the number or name of a GenICam camera.
        exposure: of a stack that has several; by default "metered", whose peaks are never
            saturated.
        image_topic: of a bag, see `open_bag`.

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
        opened = open_images(path)
    elif not path.is_file():
        raise InputError(
            f"{path} is a pipe, device or socket, which may never end. Give a file, a folder, or "
            "the number of a camera."
        )
    elif told := what_it_is(path):
        raise InputError(f"{path} is {told}.")
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
    return opened


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

    steps = np.diff([labels.time_s for labels in chosen])
    microscope = folder / "microscope.json"
    return Source(
        name=str(folder),
        read=read,
        length=len(chosen),
        rate_hz=1 / float(np.median(steps)) if steps.size and np.median(steps) > 0 else None,
        microscope_file=microscope if microscope.is_file() else None,
        medium=chosen[0].medium,
        notes=()
        if exposure or not others
        else (f"Reading the exposure {kind} (the stack also has {others}); --exposure chooses.",),
    )
