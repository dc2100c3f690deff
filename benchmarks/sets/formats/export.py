"""Writes a set or a single stack in another format."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Literal

from benchmarks.sets.read import SetStack, set_files, stacks_of
from formats.inputs import InputError
from formats.whole_files import require_space, written_whole

Format = Literal["hdf5", "ome-tiff", "coco", "webdataset", "rosbag1", "rosbag2"]

_EXTRA = {"h5py", "pycocotools"}
"""Packages of the extra `export`."""


def export(
    folder: str | Path,
    *,
    to: Format,
    out: str | Path,
    progress: Callable[[int], None] = lambda total: None,
) -> None:
    """Write a set in another format, either completely or not at all.

    Args:
        folder: a set or a stack.
        to: the format; see `benchmarks.sets.formats`.
        out: the file (hdf5) or folder to write; it must not exist.
        progress: called after each image with the total number of images.

    Raises:
        InputError: `folder` is not a set or stack, a stack is damaged or empty, `out` exists, its
            disk has too little space, or the format's library is not installed.
        BeingWrittenError: another process is writing `out`.
        OSError: `out` cannot be written.
    """
    folder, out = Path(folder), Path(out)
    with written_whole(out) as whole:
        stacks = stacks_of(folder)
        write = _writer(to)
        require_space(out, _least_bytes(stacks))
        images = sum(_checked(entry) for entry in stacks)
        if to != "hdf5":
            whole.mkdir()
        write(stacks, whole, partial(progress, images))
        for path in set_files(stacks) if to != "hdf5" else ():
            shutil.copyfile(path, whole / path.name)


def _least_bytes(stacks: Sequence[SetStack]) -> int:
    """Least size of the export: that of the images, which no format compresses more."""
    images = (path for entry in stacks for path in (entry.folder / "frames").glob("*.png"))
    return sum(path.stat().st_size for path in images)


def _checked(entry: SetStack) -> int:
    """Number of images of a stack, after a check for damage; some formats only copy the files."""
    stack = entry.open()
    stack.verify()
    if not stack.labels:
        raise InputError(f"the stack {entry.folder} has no frames. Render it again.")
    return len(stack.labels)


def _writer(to: Format) -> Callable[[Sequence[SetStack], Path, Callable[[], None]], None]:
    """The function that writes a format. Only this format's library is loaded."""
    try:
        match to:
            case "hdf5":
                from benchmarks.sets.formats import hdf5

                return hdf5.write
            case "ome-tiff":
                from benchmarks.sets.formats import ome_tiff

                return ome_tiff.write
            case "coco":
                from benchmarks.sets.formats import coco

                return coco.write
            case "webdataset":
                from benchmarks.sets.formats import webdataset

                return webdataset.write
            case "rosbag1" | "rosbag2":
                from benchmarks.sets.formats import bags

                return partial(bags.write, ros=1 if to == "rosbag1" else 2)
    except ModuleNotFoundError as error:
        if error.name not in _EXTRA:
            raise
        raise InputError(
            f"the format {to} needs the package {error.name}: pip install 'eyespot[export]'."
        ) from error
