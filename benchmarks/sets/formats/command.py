"""The command `eyespot export`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from estimator.run.options import OUT


def export(
    folder: Path,
    /,
    *,
    to: Literal["hdf5", "ome-tiff", "coco", "webdataset", "rosbag1", "rosbag2"],
    out: Annotated[Path, OUT],
) -> None:
    """Write a labelled set or a single stack in another format.

    Args:
        folder: Labelled set or stack.
        to: Format to write; see docs/datasets.md.
        out: File (hdf5) or folder to write; it must not exist yet.
    """
    from benchmarks.sets.formats.export import export as write
    from estimator.run.progress_bar import progress

    with progress("Exporting", total=None) as advance:
        write(folder, to=to, out=out, progress=lambda total: advance(note=f"of {total}"))
    print(f"Wrote {out}.")
