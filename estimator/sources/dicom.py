"""DICOM files as sources: an image or the frames of a recording (DICOM PS3.3, C.7.6.3)."""

import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from eyespot.estimator.frame_window import checked_frame
from eyespot.estimator.sources.files import rate_of
from eyespot.estimator.sources.source import AGAIN, Frame, Source, notes_of_aspect
from eyespot.formats.image_files import check_pixels
from eyespot.formats.inputs import InputError, in_utf8
from eyespot.formats.whole_files import damage_reported

DICOM = (".dcm", ".dicom")
_MARK, _MARK_AT = b"DICM", 128

_MIN_FRAME_BYTES = 8  # a compressed frame has at least the head of its item
_GREY = ("MONOCHROME1", "MONOCHROME2")
_COLOURS = ("RGB", "YBR_FULL", "YBR_FULL_422", "YBR_RCT", "YBR_ICT")  # which pydicom makes RGB


def is_dicom(path: Path) -> bool:
    """Whether a file is DICOM, by its name or its mark."""
    if path.suffix.lower() in DICOM:
        return True
    with path.open("rb") as file:
        return file.read(_MARK_AT + len(_MARK))[_MARK_AT:] == _MARK


def open_dicom(path: Path) -> Source:
    """The frames of a DICOM file, read one by one.

    Raises:
        InputError: it cannot be read, has no images, or images with a palette; or pydicom is not
            installed.
    """
    with damage_reported(f"{path}", AGAIN):
        about = _description(path)
        check_pixels(about.Columns, about.Rows)
        count = int(about.get("NumberOfFrames") or 1)
        if not 1 <= count <= path.stat().st_size // _MIN_FRAME_BYTES:
            raise InputError(f"states {count} frames, which it has no room for")
        kind = about.PhotometricInterpretation
        if kind not in (*_GREY, *_COLOURS):
            raise InputError(f"has images of the kind {kind}; grey and RGB are read")
        full_scale = 2.0**about.BitsStored - 1
        times = _times_s(about, count)
        wide, high = reversed([float(side) for side in about.get("PixelAspectRatio") or (1, 1)])

    def read() -> Iterator[Frame]:
        from pydicom.pixels import iter_pixels

        images = iter_pixels(path)
        for index in range(count):
            with damage_reported(f"{path}, frame {index}", AGAIN):
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore")  # of odd values elsewhere in the file
                    image = next(images, np.empty(0))
                if image.dtype.kind != "u" or image.dtype.itemsize > 2:
                    image = image.astype(np.float32)
                if kind == "MONOCHROME1":  # its largest value is black
                    image = np.asarray(full_scale - image, image.dtype)
                image = checked_frame(image)
            yield Frame(
                index=index,
                file_name=f"{in_utf8(path.name)}#{index}",
                time_s=float(times[index]),
                image=image,
                full_scale=full_scale if about.BitsStored < about.BitsAllocated else None,
            )

    return Source(
        name=str(path),
        read=read,
        length=count,
        rate_hz=rate_of(times),
        notes=notes_of_aspect(path.name, wide / high),
    )


def _description(path: Path) -> Any:
    """All of the file that is not its pixels."""
    try:
        from pydicom import dcmread
    except ModuleNotFoundError as error:
        raise InputError("needs the package pydicom: pip install 'eyespot[dicom]'") from error
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        about = dcmread(path, stop_before_pixels=True)
    missing = [name for name in ("Rows", "BitsStored") if name not in about]
    if missing:
        raise InputError("has no images (no Rows in it). Choose a file with images")
    return about


def _times_s(about: Any, count: int) -> np.ndarray:
    """When the frames were taken, from the first on; NaN where the file does not say."""
    if about.get("FrameTimeVector"):
        steps = np.array(about.FrameTimeVector, float)
        if steps.size == count:
            return np.cumsum(steps) / 1000
    step_ms = float(about.get("FrameTime") or np.nan)
    return np.arange(count) * step_ms / 1000 if count > 1 else np.full(count, np.nan)
