"""The command `eyespot export`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer


def export(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Labelled set or stack.")],
    to: Annotated[
        Literal["hdf5", "ome-tiff", "coco", "webdataset", "rosbag1", "rosbag2"],
        typer.Option(help="Format to write. benchmarks/sets/formats describes the formats."),
    ],
    out: Annotated[
        Path,
        typer.Option(
            "--out", metavar="PATH", help="File (hdf5) or folder to write; it must not exist yet."
        ),
    ],
) -> None:
    """Write a labelled set or a single stack in another format."""
    from benchmarks.sets.formats.export import export as write
    from estimator.run import progress

    with progress("Exporting", total=None) as advance:
        write(folder, to=to, out=out, progress=lambda total: advance(note=f"of {total}"))
    print(f"Wrote {out}.")
