"""OME-TIFF: one file SPLIT/STACK/EXPOSURE.ome.tif for each recording, with labels beside it.

The first image series contains the frames with the size of a pixel at the retinal pole, and the
time and exposure time of each frame. The second series contains the masks. The two exposures are
separate files, because channels of one file would look like colours.
"""

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from tifffile import TiffWriter

from eyespot.benchmarks.sets.read import SetStack, exposures_of
from eyespot.formats.microscope import read_microscope
from eyespot.formats.stack import FrameLabels, Stack

_CLASSIC_BYTES = 2**32 - 2**25  # size limit of a TIFF with 32-bit offsets, less its tags


def write(stacks: Sequence[SetStack], out: Path, progress: Callable[[], None]) -> None:
    """Write the files, with a few images at a time in memory."""
    for entry in stacks:
        stack = entry.open()
        folder = out / entry.qualified_name
        scale_um = 1e3 * read_microscope(stack.folder / "microscope.json").scale_mm_px
        for exposure in exposures_of(stack):
            _write_recording(folder / f"{exposure}.ome.tif", stack, exposure, scale_um, progress)


def _write_recording(
    path: Path, stack: Stack, exposure: str, scale_um: float, progress: Callable[[], None]
) -> None:
    rows = stack.exposed(exposure)
    frame, mask = stack.image(rows[0]), stack.mask(rows[0])

    def frames() -> Iterator[np.ndarray]:
        for row in rows:
            yield stack.image(row)
            progress()

    pixels = {
        "PhysicalSizeX": scale_um,
        "PhysicalSizeXUnit": "µm",
        "PhysicalSizeY": scale_um,
        "PhysicalSizeYUnit": "µm",
        # OME's DeltaT is the start of an exposure; our times are its middle.
        "Plane": {
            "DeltaT": [row.time_s - row.exposure_s / 2 for row in rows],
            "DeltaTUnit": ["s"] * len(rows),
            "ExposureTime": [row.exposure_s for row in rows],
            "ExposureTimeUnit": ["s"] * len(rows),
        },
    }
    bytes_ = len(rows) * (frame.nbytes + mask.nbytes)
    with TiffWriter(path, ome=True, bigtiff=bytes_ > _CLASSIC_BYTES) as file:
        _write_series(file, frames(), frame, rows, {**pixels, "Name": exposure})
        _write_series(file, map(stack.mask, rows), mask, rows, {**pixels, "Name": "mask"})


def _write_series(
    file: TiffWriter,
    images: Iterator[np.ndarray],
    like: np.ndarray,
    rows: Sequence[FrameLabels],
    metadata: dict[str, Any],
) -> None:
    colour = like.ndim == 3
    file.write(
        images,
        shape=(len(rows), *like.shape),
        dtype=like.dtype,
        photometric="rgb" if colour else "minisblack",
        compression="zlib",
        compressionargs={"level": 1},
        metadata={**metadata, "axes": "TYXS" if colour else "TYX"},
    )
