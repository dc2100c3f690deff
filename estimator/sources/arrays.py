"""Arrays as sources: NumPy's .npy and .npz, and HDF5."""

import math
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np

from eyespot.estimator.frame_window import checked_frame
from eyespot.estimator.sources.source import AGAIN, Frame, Source
from eyespot.formats.image_files import check_pixels
from eyespot.formats.inputs import InputError, in_utf8
from eyespot.formats.whole_files import damage_reported

ARRAYS = (".npy", ".npz", ".h5", ".hdf5")
_COLOURS = 3
_KINDS = "uf"


def open_array(path: Path) -> Source:
    """An image or frames in an array of (H, W), (H, W, 3), (N, H, W) or (N, H, W, 3).

    A file with several arrays must have exactly one of such a shape.

    Raises:
        InputError: it cannot be read, or has no such array or several.
    """
    with ExitStack() as files, damage_reported(f"{path}", AGAIN):
        shape = _frames_in(path, files).shape
        check_pixels(*shape[1:3])

    def read() -> Iterator[Frame]:
        with ExitStack() as files:
            with damage_reported(f"{path}", AGAIN):
                frames = _frames_in(path, files)
            for index in range(len(frames)):
                with damage_reported(f"{path}, frame {index}", AGAIN):
                    image = checked_frame(np.ascontiguousarray(frames[index]))
                yield Frame(index=index, file_name=f"{in_utf8(path.name)}#{index}", image=image)

    return Source(name=str(path), read=read, length=shape[0])


def _frames_in(path: Path, files: ExitStack) -> Any:
    """The array of a file that has frames, with them on its first axis; read frame by frame."""
    if path.suffix.lower() == ".npy":
        arrays = {path.name: np.load(path, mmap_mode="r", allow_pickle=False)}
    elif path.suffix.lower() == ".npz":
        # NumPy itself leaves a damaged file open.
        file = files.enter_context(path.open("rb"))
        arrays = dict(files.enter_context(np.load(file, allow_pickle=False)))
    else:
        arrays = _datasets(path, files)
    found = {name: array for name, array in arrays.items() if _has_frames(array)}
    if len(found) != 1:
        shapes = ", ".join(f"{name} {array.shape} {array.dtype}" for name, array in arrays.items())
        raise InputError(
            f"must hold one array of frames, (N, H, W) or (N, H, W, 3) of whole numbers or floats; "
            f"it holds {shapes or 'none'}. Save the frames alone, with numpy.save"
        )
    (array,) = found.values()
    is_one = array.ndim == 2 or (array.ndim == 3 and array.shape[-1] == _COLOURS)
    return np.asarray(array)[None] if is_one else array


def _has_frames(array: Any) -> bool:
    last_is_colour = array.shape[-1:] == (_COLOURS,)
    return (
        array.dtype.kind in _KINDS
        and (array.ndim in (2, 3) or (array.ndim == 4 and last_is_colour))
        and math.prod(array.shape) > 0
        and min(array.shape[-3 if last_is_colour else -2 :][:2]) > 1
    )


def _datasets(path: Path, files: ExitStack) -> dict[str, Any]:
    try:
        import h5py
    except ModuleNotFoundError as error:
        raise InputError("needs the package h5py: pip install 'eyespot[export]'") from error
    found: dict[str, Any] = {}
    opened = files.enter_context(h5py.File(path, "r"))
    opened.visititems(
        lambda name, of: found.update({name: of}) if isinstance(of, h5py.Dataset) else None
    )
    return found
