"""HDF5: one file with a group SPLIT/STACK for each stack.

The datasets `set.json` and `LICENSE` contain these files as text. Each group has

frames       n x H x W (x 3)
masks        n x H x W, 255 where the spot is visible
labels/      one dataset of n rows for each column of metadata.jsonl, with its attribute `unit`
kinematics/  poses that the robot reported, in the same form

and the attributes `stack.toml` (the scene) and `microscope.json` (the camera), as text.
"""

import io
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from eyespot.benchmarks.sets.read import SetStack, set_files
from eyespot.formats.inputs import InputError, check_values, in_file, read_text
from eyespot.formats.report_page import UNITS, unit_at_end
from eyespot.formats.stack import Stack

_SCHEMA = 1
_TEXT = {"file_name", "mask_file_name", "exposure", "medium"}


def write(stacks: Sequence[SetStack], out: Path, progress: Callable[[], None]) -> None:
    """Write the file, with one image at a time in memory."""

    def image_done() -> None:
        disk.check()
        progress()

    with _Disk(out, "w+") as disk:
        try:
            with h5py.File(disk, "w") as file:
                file.attrs["schema"] = _SCHEMA
                for path in set_files(stacks):
                    file.create_dataset(path.name, data=_text(path))
                for entry in stacks:
                    group, stack = file.create_group(entry.qualified_name), entry.open()
                    for name in ("stack.toml", "microscope.json"):
                        group.attrs[name] = _text(stack.path_of(name))
                    labels = group.create_group("labels")
                    for name in stack.labels[0].row():
                        _write_column(labels, name, [getattr(row, name) for row in stack.labels])
                    if stack.path_of("kinematics.csv").is_file():
                        report = group.create_group("kinematics")
                        for name, column in stack.kinematics().items():
                            _write_column(report, name, column)
                    _write_images(group, stack, image_done)
        finally:
            disk.check()


class _Disk(io.FileIO):
    """A file whose errors HDF5 does not see, because its library crashes after an error."""

    error: OSError | None = None

    def write(self, data: Any, /) -> int:
        """Write all bytes."""
        left = memoryview(data).cast("B")
        size = len(left)
        try:
            while left:
                left = left[super().write(left) :]
        except OSError as error:
            self.error = self.error or error
        return size

    def truncate(self, size: int | None = None, /) -> int:
        """Set the size."""
        try:
            return super().truncate(size)
        except OSError as error:
            self.error = self.error or error
            return size or 0

    def check(self) -> None:
        """Raise the first error."""
        if self.error:
            raise self.error


def _text(path: Path) -> str:
    """A text file's content; HDF5 cannot have a NUL in it."""
    with in_file(path):
        text = read_text(path)
        check_values(text)
    return text


def _write_images(group: h5py.Group, stack: Stack, progress: Callable[[], None]) -> None:
    count, first = len(stack.labels), stack.labels[0]

    def images(name: str, like: np.ndarray) -> h5py.Dataset:
        # One chunk per image, to read single frames; level 1, because noise compresses badly.
        return group.create_dataset(
            name,
            (count, *like.shape),
            like.dtype,
            chunks=(1, *like.shape),
            compression="gzip",
            compression_opts=1,
        )

    frames, masks = images("frames", stack.image(first)), images("masks", stack.mask(first))
    for index, row in enumerate(stack.labels):
        for dataset, image in ((frames, stack.image(row)), (masks, stack.mask(row))):
            if (image.shape, image.dtype) != (dataset.shape[1:], dataset.dtype):
                raise InputError(
                    f"{stack.folder / row.file_name}: size or depth differ from the first image's. "
                    "Render the stack again."
                )
            dataset[index] = image
        progress()


def _write_column(group: h5py.Group, name: str, values: list[object] | np.ndarray) -> None:
    text = h5py.string_dtype() if name in _TEXT else None
    column = group.create_dataset(name, data=values, dtype=text)
    if name not in _TEXT:
        column.attrs["unit"] = UNITS.get(unit_at_end(name), "1")
