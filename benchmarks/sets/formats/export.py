"""`eyespot export`: writes a set or a single stack in another format."""

import importlib
import shutil
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Annotated, Literal

from eyespot.benchmarks.sets.read import SetStack, copy_description, set_files, stacks_of
from eyespot.estimator.run.options import OUT
from eyespot.estimator.run.progress_bar import progress
from eyespot.formats.inputs import InputError
from eyespot.formats.whole_files import require_space, written_whole

Format = Literal["hdf5", "ome-tiff", "coco", "webdataset", "rosbag1", "rosbag2"]

_PACKAGES_OF_EXTRA = {"h5py", "pycocotools"}


def export(folder: Path, /, *, to: Format, out: Annotated[Path, OUT]) -> None:
    """Write a labelled set or a single stack in another format.

    Args:
        folder: Labelled set or stack.
        to: Format to write; see docs/datasets.md.
        out: File (hdf5) or folder to write; it must not exist yet.
    """
    with progress("Exporting", total=None) as advance, written_whole(out) as whole:
        stacks = stacks_of(folder)
        write = _writer(to)
        pictures = (path for entry in stacks for path in (entry.folder / "frames").glob("*.png"))
        require_space(out, sum(path.stat().st_size for path in pictures))  # none compresses more
        images = 0
        for entry in stacks:  # some formats only copy the files
            stack = entry.open()
            stack.verify()
            if not stack.labels:
                raise InputError(f"the stack {entry.folder} has no frames. Render it again.")
            images += len(stack.labels)
        if to != "hdf5":
            whole.mkdir()
            for entry in stacks:
                copy_description(entry, whole / entry.qualified_name)
        write(stacks, whole, partial(advance, note=f"of {images}"))
        for path in set_files(stacks) if to != "hdf5" else ():
            shutil.copyfile(path, whole / path.name)
    print(f"Wrote {out}.")


def _writer(to: Format) -> Callable[[Sequence[SetStack], Path, Callable[[], None]], None]:
    """The function that writes a format. Only this format's library is loaded."""
    name, version = ("bags", int(to[-1])) if to.startswith("rosbag") else (to.replace("-", "_"), 0)
    try:
        module = importlib.import_module(f"eyespot.benchmarks.sets.formats.{name}")
    except ModuleNotFoundError as error:
        if error.name not in _PACKAGES_OF_EXTRA:
            raise
        raise InputError(
            f"the format {to} needs the package {error.name}: pip install 'eyespot[export]'."
        ) from error
    return partial(module.write, ros=version) if version else module.write
